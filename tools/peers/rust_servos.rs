// SPDX-License-Identifier: Apache-2.0
//! XL330s on a pseudo-terminal, by the device side of the crate dynamixel2; `rust_servos.py` has the driver use them.
//!
//! What is on the wire is that crate's. Control table and motor are those of ROBOTIS' e-manual (xl330-m288), as it is
//! read here; nothing is shared with softgrip_emulator. Firmware 45 has no Fast Sync Read, which the crate lacks too.
//! The release on crates.io has no device side yet, so it is built as an example of the source:
//!
//!     git clone https://github.com/robohouse-delft/dynamixel2-rs && cp tools/peers/rust_servos.rs dynamixel2-rs/examples
//!     cd dynamixel2-rs && cargo build --locked --release --features serial2/unix --example rust_servos
//!
//! Each argument is the slack [m] of a tendon of 1.5 N/mm on a spool of 10 mm. It prints its port and, once its standard
//! input has ended, what was counted.

use dynamixel2::device::{Device, Instruction, Instructions};
use std::io::Read;
use std::os::fd::AsRawFd;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::Arc;
use std::time::{Duration, Instant};

const MODEL_NUMBER: u16 = 1200;
const FIRMWARE: u8 = 45;
const BROADCAST: u8 = 254;
/// Status errors of the protocol: data range, access.
const DATA_RANGE: u8 = 4;
const ACCESS: u8 = 7;

const OPERATING_MODE: usize = 11;
const PWM_LIMIT: usize = 36;
const CURRENT_LIMIT: usize = 38;
const TORQUE_ENABLE: usize = 64;
const STATUS_RETURN_LEVEL: usize = 68;
const POSITION_P_GAIN: usize = 84;
const BUS_WATCHDOG: usize = 98;
const GOAL_PWM: usize = 100;
const GOAL_CURRENT: usize = 102;
const GOAL_POSITION: usize = 116;
const PRESENT_PWM: usize = 124;
const PRESENT_CURRENT: usize = 126;
const PRESENT_VELOCITY: usize = 128;
const PRESENT_POSITION: usize = 132;
const PRESENT_VOLTAGE: usize = 144;
const PRESENT_TEMPERATURE: usize = 146;
const TABLE_SIZE: usize = 228;

/// XL330-M288 at 5 V: stall torque 0.52 N m at 1.47 A; 885 units are a duty cycle of 1; 0.229 rpm a unit.
const SUPPLY_V: f64 = 5.0;
const RESISTANCE: f64 = SUPPLY_V / 1.47;
const TORQUE_CONSTANT: f64 = 0.52 / 1.47;
const PWM_UNITS: f64 = 885.0;
const RAD_PER_PULSE: f64 = std::f64::consts::TAU / 4096.0;
const RAD_S_PER_UNIT: f64 = 0.229 * std::f64::consts::TAU / 60.0;
/// Assumed: friction of the gears, rotor behind them.
const FRICTION_NM: f64 = 0.012;
const INERTIA: f64 = 0.0012;
const BACK_EMF: f64 = 0.36;
const STIFFNESS_N_M: f64 = 1500.0;
const SPOOL_M: f64 = 0.010;
const STEP_S: f64 = 0.0002;

struct Servo {
    id: u8,
    slack_m: f64,
    angle: f64,
    speed: f64,
    duty: f64,
    heard: Instant,
    table: [u8; TABLE_SIZE],
    heard_count: u64,
    refused_count: u64,
}

impl Servo {
    fn new(id: u8, slack_m: f64) -> Self {
        let mut servo = Servo {
            id, slack_m, angle: 0.0, speed: 0.0, duty: 0.0, heard: Instant::now(), table: [0; TABLE_SIZE],
            heard_count: 0, refused_count: 0,
        };
        servo.put(0, 2, i64::from(MODEL_NUMBER));
        let bytes = [(6, FIRMWARE), (7, id), (8, 3), (9, 250), (OPERATING_MODE, 3), (12, 255), (13, 2), (31, 70), (63, 53),
                     (STATUS_RETURN_LEVEL, 2), (PRESENT_TEMPERATURE, 25)];
        for (address, value) in bytes {
            servo.table[address] = value;
        }
        let words = [(32, 70), (34, 35), (PWM_LIMIT, 885), (CURRENT_LIMIT, 1750), (76, 1600), (78, 180), (POSITION_P_GAIN, 400),
                     (GOAL_PWM, 885), (GOAL_CURRENT, 1750), (PRESENT_VOLTAGE, 50)];
        for (address, value) in words {
            servo.put(address, 2, value);
        }
        servo.put(44, 4, 445);
        servo.put(52, 4, 0);
        servo.put(48, 4, 4095);
        servo
    }

    fn get(&self, address: usize, size: usize) -> i64 {
        let mut bytes = [0u8; 8];
        bytes[..size].copy_from_slice(&self.table[address..address + size]);
        let shift = 64 - 8 * size as u32;
        (i64::from_le_bytes(bytes) << shift) >> shift
    }

    fn put(&mut self, address: usize, size: usize, value: i64) {
        self.table[address..address + size].copy_from_slice(&value.to_le_bytes()[..size]);
    }

    fn has_torque(&self) -> bool {
        self.table[TORQUE_ENABLE] != 0
    }

    /// Write what an instruction carries; returns the status error.
    fn write(&mut self, address: usize, data: &[u8]) -> u8 {
        if address + data.len() > TABLE_SIZE || (address < TORQUE_ENABLE && self.has_torque()) || address >= PRESENT_PWM && address < 168 {
            return ACCESS;
        }
        let goals = GOAL_PWM..PRESENT_PWM;
        if goals.contains(&address) && self.table[BUS_WATCHDOG] == 255 {
            return DATA_RANGE;
        }
        let limit = self.get(CURRENT_LIMIT, 2);
        let (mode, torque) = (self.table[OPERATING_MODE], self.has_torque());
        self.table[address..address + data.len()].copy_from_slice(data);
        if address == GOAL_CURRENT && self.get(GOAL_CURRENT, 2).abs() > limit {
            self.put(GOAL_CURRENT, 2, limit);
            return 6;
        }
        if self.table[OPERATING_MODE] != mode {
            let pwm = self.get(PWM_LIMIT, 2);
            self.put(GOAL_PWM, 2, pwm);
            self.put(GOAL_CURRENT, 2, limit);
        }
        if self.has_torque() && !torque {
            let here = self.get(PRESENT_POSITION, 4);
            self.put(GOAL_POSITION, 4, here);
        }
        0
    }

    fn tension(&self) -> f64 {
        (STIFFNESS_N_M * (self.angle * SPOOL_M - self.slack_m)).max(0.0)
    }

    /// The largest duty cycle that the supply's current allows, the shaft at its speed.
    fn largest_duty(&self) -> f64 {
        let current = self.get(GOAL_CURRENT, 2).abs() as f64 * 1e-3;
        let idle = BACK_EMF * self.speed.abs() / RESISTANCE;
        let duty = (idle + (idle * idle + 4.0 * SUPPLY_V * current / RESISTANCE).sqrt()) * RESISTANCE / (2.0 * SUPPLY_V);
        duty.min(self.get(GOAL_PWM, 2).abs() as f64 / PWM_UNITS)
    }

    fn step(&mut self) {
        let watchdog = self.table[BUS_WATCHDOG] as u64;
        if watchdog > 0 && watchdog < 128 && self.has_torque() && self.heard.elapsed() > Duration::from_millis(20 * watchdog) {
            self.table[BUS_WATCHDOG] = 255;
            let here = self.get(PRESENT_POSITION, 4);
            self.put(GOAL_POSITION, 4, here);
        }
        // Position P gain: 1/128 PWM units a pulse (e-manual, items 80 to 84).
        let off = self.get(GOAL_POSITION, 4) as f64 - self.angle / RAD_PER_PULSE;
        let wanted = self.get(POSITION_P_GAIN, 2) as f64 / 128.0 * off / PWM_UNITS;
        let most = self.largest_duty();
        self.duty = if self.has_torque() { wanted.clamp(-most, most) } else { 0.0 };
        let current = if self.has_torque() { (self.duty * SUPPLY_V - BACK_EMF * self.speed) / RESISTANCE } else { 0.0 };
        let pulled = TORQUE_CONSTANT * current - self.tension() * SPOOL_M;
        let moved = self.speed + STEP_S / INERTIA * pulled;
        let brake = STEP_S / INERTIA * FRICTION_NM;
        self.speed = if moved.abs() <= brake { 0.0 } else { moved - brake * moved.signum() };
        self.angle += STEP_S * self.speed;
        self.put(PRESENT_PWM, 2, (self.duty * PWM_UNITS).round() as i64);
        self.put(PRESENT_CURRENT, 2, (1e3 * self.duty * current).round() as i64);
        self.put(PRESENT_VELOCITY, 4, (self.speed / RAD_S_PER_UNIT).round() as i64);
        self.put(PRESENT_POSITION, 4, (self.angle / RAD_PER_PULSE).round() as i64);
    }
}

/// Do an instruction; returns the status packets: ID, error, parameters.
fn answers(servos: &mut [Servo], packet: Instruction<Vec<u8>>) -> Vec<(u8, u8, Vec<u8>)> {
    let mut replies = Vec::new();
    for servo in servos.iter_mut() {
        servo.heard = Instant::now();
        let is_meant = packet.id == servo.id;
        let is_all = packet.id == BROADCAST;
        servo.heard_count += u64::from(is_meant || is_all);
        match &packet.instruction {
            Instructions::Ping if is_meant || is_all => {
                replies.push((servo.id, 0, vec![MODEL_NUMBER as u8, (MODEL_NUMBER >> 8) as u8, FIRMWARE]));
            }
            Instructions::Read { address, length } if is_meant => {
                let (from, size) = (*address as usize, *length as usize);
                let data = servo.table.get(from..from + size).map(<[u8]>::to_vec);
                replies.push((servo.id, if data.is_some() { 0 } else { ACCESS }, data.unwrap_or_default()));
            }
            Instructions::Write { address, parameters } if is_meant || is_all => {
                let error = servo.write(*address as usize, parameters);
                servo.refused_count += u64::from(error != 0);
                if is_meant && servo.table[STATUS_RETURN_LEVEL] == 2 {
                    replies.push((servo.id, error, Vec::new()));
                }
            }
            Instructions::SyncRead { address, length, ids } if ids.contains(&servo.id) => {
                let (from, size) = (*address as usize, *length as usize);
                replies.push((servo.id, 0, servo.table[from..from + size].to_vec()));
            }
            Instructions::SyncWrite { address, length, parameters } => {
                let id = servo.id;
                for entry in parameters.chunks(1 + *length as usize).filter(|entry| entry[0] == id) {
                    let error = servo.write(*address as usize, &entry[1..]);
                    servo.refused_count += u64::from(error != 0);
                }
            }
            _ => {}
        }
    }
    if let Instructions::SyncRead { ids, .. } = &packet.instruction {
        replies.sort_by_key(|reply| ids.iter().position(|id| *id == reply.0));
    }
    replies
}

fn main() -> std::io::Result<()> {
    let slacks: Vec<f64> = std::env::args().skip(1).map(|text| text.parse().expect("a slack in metres")).collect();
    let mut servos: Vec<Servo> = slacks.iter().zip(1..).map(|(slack, id)| Servo::new(id, *slack)).collect();
    let (ours, theirs) = serial2::SerialPort::pair()?;
    println!("{}", std::fs::read_link(format!("/proc/self/fd/{}", theirs.as_raw_fd()))?.display());
    let mut device = Device::new(ours)?;
    let ended = Arc::new(AtomicBool::new(false));
    let seen = ended.clone();
    std::thread::spawn(move || {
        let _ = std::io::stdin().read_to_end(&mut Vec::new());
        seen.store(true, Ordering::Relaxed);
    });
    let (mut packets, mut unreadable, mut unknown, mut told) = (0u64, 0u64, 0u64, 0u64);
    let began = Instant::now();
    let mut steps = 0u64;
    while !ended.load(Ordering::Relaxed) {
        // After a long pause of this process only its last second is made up for.
        let due = (began.elapsed().as_secs_f64() / STEP_S) as u64;
        steps = steps.max(due.saturating_sub(5000));
        while steps < due {
            servos.iter_mut().for_each(Servo::step);
            steps += 1;
        }
        match device.read_owned(Duration::from_micros(500)) {
            Ok(packet) => {
                packets += 1;
                unknown += u64::from(matches!(packet.instruction, Instructions::Unknown { .. }));
                for (id, error, data) in answers(&mut servos, packet) {
                    let written = device.write_status(id, error, data.len(), |buffer| {
                        buffer.copy_from_slice(&data);
                        Ok(())
                    });
                    told += u64::from(written.is_ok());
                }
            }
            Err(dynamixel2::ReadError::Io(error)) if error.kind() == std::io::ErrorKind::TimedOut => {}
            Err(error) => {
                unreadable += 1;
                eprintln!("{error}");
            }
        }
    }
    let refused: u64 = servos.iter().map(|servo| servo.refused_count).sum();
    println!("packets={packets} answers={told} unreadable={unreadable} unknown={unknown} refused={refused}");
    Ok(())
}
