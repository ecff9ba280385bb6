# SPDX-License-Identifier: Apache-2.0
"""The whole rig: plant, devices and their ports, and what can be made to go wrong."""

from __future__ import annotations

from typing import TYPE_CHECKING, Self

from softgrip_emulator.clock import RealTimeClock, ScaledCellClock
from softgrip_emulator.errors import EmulatorError
from softgrip_emulator.rig.amplifier import FORMATS, HX711_NOISE_N, EmulatedAmplifier
from softgrip_emulator.rig.grbl import EmulatedGrblStage
from softgrip_emulator.rig.mark10_gauge import EmulatedMark10Gauge
from softgrip_emulator.rig.mark10_stand import EmulatedMark10Stand
from softgrip_emulator.rig.plant import RigPlant
from softgrip_emulator.rig.polled import PROTOCOLS, EmulatedPolledGauge
from softgrip_emulator.rig.sensor import LoadCell, OtherLine
from softgrip_emulator.rig.sketches import SKETCHES, EmulatedBoard
from softgrip_emulator.rig.truth import RigTruth
from softgrip_emulator.wire.pty import PtyPort

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from softgrip_emulator.clock import CellClock
    from softgrip_emulator.wire.device import Port, WireDevice

#: gauges beside the Mark-10: formats of an amplifier, boards with a sketch, gauges that are asked
LINE_GAUGES = (*FORMATS, *SKETCHES, *PROTOCOLS)
#: [N] of the emulated gauge (Mark-10 M5-10).
GAUGE_CAPACITY = 50.0


class EmulatedRig:
    """A friction rig behind pseudo-terminals ``<directory>/stand`` and ``<directory>/gauge``.

    Usage::

        with EmulatedRig(seed=1, time_scale=30.0) as rig:
            rig.open_ports(Path("/tmp/cell"))
            rig.set(angle_rad=0.87, load_kg=0.6)

    Args:
        seed: of the cable, the rig and the noise.
        time_scale: cell seconds per wall second; the driver must be told the same.
        truth: what is so, instead of what the seed draws.
        plant: what the stage pulls, instead of the friction rig's cable.
        clock: shared cell time, instead of an own one.
        stage: "mark10" (test stand), "grbl" (linear stage) or "grblhal" (the same with that firmware).
        stage_settings: of a GRBL stage that differ from a new controller's, by their number.
        stage_resets: times that opening a GRBL stage's port resets it.
        gauge: "gcl2" (Mark-10); in `softgrip_emulator.rig` a format of `amplifier.FORMATS` for a streaming amplifier, a
            sketch of `sketches.SKETCHES` for a board, or a protocol of `polled.PROTOCOLS`.
    """

    def __init__(
        self,
        seed: int = 1,
        time_scale: float = 1.0,
        *,
        truth: RigTruth | None = None,
        plant: RigPlant | None = None,
        clock: CellClock | None = None,
        stage: str = "mark10",
        gauge: str = "gcl2",
        stage_settings: Mapping[int, float] | None = None,
        stage_resets: int = 1,
    ) -> None:
        self.clock = clock or ScaledCellClock(RealTimeClock(), time_scale)
        self.truth = truth or RigTruth.from_seed(seed)
        self.plant = plant or RigPlant(self.truth, seed)
        self.cell = LoadCell(self.plant, GAUGE_CAPACITY, seed, HX711_NOISE_N if gauge in SKETCHES else None)
        self.stand: EmulatedMark10Stand | EmulatedGrblStage = (
            EmulatedGrblStage(self.plant, settings=stage_settings, is_hal=stage == "grblhal", resets=stage_resets)
            if stage in {"grbl", "grblhal"}
            else EmulatedMark10Stand(self.plant, self.cell)
        )
        self.gauge = _gauge(gauge, self.cell)
        self._ports: dict[str, Port] = {}
        self._misplaced: dict[str, float] = {}
        self._active: dict[str, Callable[[], None]] = {}

    # -- ports -----------------------------------------------------------------------------------------------------

    def open_ports(self, directory: Path, make: Callable[[Path, WireDevice], Port] | None = None) -> Self:
        """Make the ports appear in a folder and serve them.

        Args:
            directory: the folder.
            make: a started port of another kind than pseudo-terminals, from its path and its device.
        """
        for name, device in (("stand", self.stand), ("gauge", self.gauge)):
            path = directory / name
            self._ports[name] = make(path, device) if make else PtyPort(path, device, clock=self.clock).start()
        return self

    def close(self) -> None:
        """Take the ports away."""
        for port in self._ports.values():
            port.close()
        self._ports.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # -- what a person does ----------------------------------------------------------------------------------------

    def set(self, angle_rad: float, load_kg: float) -> None:
        """Set the wrap angle [rad] and hang a mass [kg]; an angle of 0 takes the cable off the surface."""
        with self.plant.lock:
            self.plant.advance(self.clock.now_s())
            angle = angle_rad + self._misplaced.get("wrong_angle", 0.0)
            self.plant.set(angle, load_kg * self._misplaced.get("wrong_weight", 1.0))

    def hang_gauge(self, look: Callable[[], float] | None) -> None:
        """Hang the gauge into another line, of which ``look`` gives the force [N]; None: back into the rig's cable."""
        self.cell.hang(self.plant if look is None else OtherLine(self.truth, look))

    # -- what goes wrong -------------------------------------------------------------------------------------------

    @property
    def faults(self) -> tuple[str, ...]:
        """Names of the faults that `inject` knows."""
        return tuple(sorted(self._makers()))

    @property
    def active_faults(self) -> tuple[str, ...]:
        """Names of the faults that are on."""
        return tuple(sorted(self._active))

    def inject(self, fault: str, **arguments: float | str) -> None:
        """Make something go wrong; `clear` ends it.

        Args:
            fault: one of `faults`.
            arguments: of the fault: ``angle`` [rad] of wrong_angle, ``rate`` [N/s] of drift, ``unit`` of unit_switched,
                ``factor`` of wrong_weight, ``port`` ("stand" or "gauge") of unplugged, ``capacity`` [N] of saturated,
                ``boot`` [s] of board_reset.

        Raises:
            EmulatorError: no such fault, or arguments it does not take.
        """
        maker = self._makers().get(fault)
        if maker is None:
            raise EmulatorError(f"rig fault '{fault}': expected one of {', '.join(self.faults)}")
        # One that is on already starts again: what it undoes is what was before any.
        self.clear(fault)
        try:
            self._active[fault] = maker(**arguments)
        except TypeError as error:
            raise EmulatorError(f"rig fault '{fault}': {error}") from error

    def clear(self, fault: str = "") -> None:
        """End one fault, or all."""
        for name in [fault] if fault else list(self._active):
            undo = self._active.pop(name, None)
            if undo is not None:
                undo()

    def _makers(self) -> dict[str, Callable[..., Callable[[], None]]]:
        makers: dict[str, Callable[..., Callable[[], None]]] = {
            "stand_silent": lambda: _flag(self.stand, "silent"),
            "gauge_silent": lambda: _flag(self.gauge, "silent"),
            "stand_reply_cut": lambda: _flag(self.stand, "reply_cut"),
            "gauge_reply_cut": lambda: _flag(self.gauge, "reply_cut"),
            "cell_stuck": lambda: _flag(self.cell, "stuck"),
            "cell_cut": lambda: _flag(self.cell, "cut"),
            "cell_reversed": lambda: _flag(self.cell, "reversed"),
            "saturated": self._saturated,
            "drift": self._drift,
            "stage_jammed": self._jammed,
            "unplugged": self._unplugged,
            "wrong_weight": lambda factor=0.0: self._misplace("wrong_weight", float(factor)),
            "wrong_angle": lambda angle=-0.5: self._misplace("wrong_angle", float(angle)),
        }
        return makers | self._stand_faults() | self._gauge_faults()

    def _stand_faults(self) -> dict[str, Callable[..., Callable[[], None]]]:
        stand = self.stand
        if isinstance(stand, EmulatedGrblStage):
            return {"alarm": lambda: _flag(stand, "alarm")}

        def auto_return() -> Callable[[], None]:
            stand.panel_auto_return()
            return lambda: setattr(stand, "pc_control", True)

        return {"auto_return": auto_return}

    def _gauge_faults(self) -> dict[str, Callable[..., Callable[[], None]]]:
        gauge = self.gauge
        if not isinstance(gauge, EmulatedMark10Gauge):
            noisy: dict[str, Callable[..., Callable[[], None]]] = {"contaminated_stream": lambda: _flag(gauge, "noisy")}
            return noisy | ({"board_reset": self._board_reset} if isinstance(gauge, EmulatedBoard) else {})

        def unit_switched(unit: str = "LB") -> Callable[[], None]:
            gauge.panel_unit(unit)
            return lambda: gauge.panel_unit("N")

        def contaminated(rate: float = 50.0) -> Callable[[], None]:
            gauge.panel_auto_output(int(rate), self.clock.now_s())
            return lambda: gauge.panel_auto_output(0, self.clock.now_s())

        def battery_low() -> Callable[[], None]:
            gauge.battery = 3
            return lambda: setattr(gauge, "battery", 0)

        return {
            "illegal_command": lambda: _flag(gauge, "illegal"),
            "unit_switched": unit_switched,
            "contaminated_stream": contaminated,
            "battery_low": battery_low,
        }

    def _saturated(self, capacity: float = 1.5) -> Callable[[], None]:
        before, self.cell.capacity = self.cell.capacity, capacity

        def undo() -> None:
            self.cell.capacity = before

        return undo

    def _drift(self, rate: float = 0.05) -> Callable[[], None]:
        self.cell.drift_rate = rate

        def undo() -> None:
            self.cell.drift_rate = 0.0

        return undo

    def _jammed(self) -> Callable[[], None]:
        self.plant.jam(True)
        return lambda: self.plant.jam(False)

    def _unplugged(self, port: str = "gauge") -> Callable[[], None]:
        if port not in self._ports:
            raise EmulatorError(f"rig fault 'unplugged': expected a port of {', '.join(self._ports)}, found '{port}'")
        self._ports[port].unplug()
        return self._ports[port].plug

    def _board_reset(self, boot: float = 1.6) -> Callable[[], None]:
        if isinstance(self.gauge, EmulatedBoard):
            self.gauge.reset(self.clock.now_s(), float(boot))
        # It comes back by itself.
        return lambda: None

    def _misplace(self, what: str, value: float) -> Callable[[], None]:
        self._misplaced[what] = value

        def undo() -> None:
            self._misplaced.pop(what, None)

        return undo


def _gauge(kind: str, cell: LoadCell) -> EmulatedMark10Gauge | EmulatedAmplifier | EmulatedBoard | EmulatedPolledGauge:
    """Return the electronics that read the cell."""
    if kind == "gcl2":
        return EmulatedMark10Gauge(cell)
    if kind in SKETCHES:
        return EmulatedBoard(cell, kind)
    return EmulatedPolledGauge(cell, kind) if kind in PROTOCOLS else EmulatedAmplifier(cell, kind)


def _flag(device: object, name: str) -> Callable[[], None]:
    setattr(device, name, True)
    return lambda: setattr(device, name, False)
