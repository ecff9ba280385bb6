# SPDX-License-Identifier: Apache-2.0
"""Lead the fingers with your hand: a camera or a film in, tendon/trajectory out, while a dead-man switch is held."""

from __future__ import annotations

import argparse
import math
import sys
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from pathlib import Path

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.utilities import remove_ros_args
from rich.console import Console

from softgrip_design.capture.detector import INSTALL, HandDetector, MediaPipeDetector
from softgrip_design.capture.frames import Images, Video, VideoFrame
from softgrip_design.errors import DesignError
from softgrip_design.nodes.finger_link import FingerLink
from softgrip_design.teleoperation.demonstration import Demonstrations, Phase
from softgrip_design.teleoperation.follower import FollowerSettings, HandFollower
from softgrip_design.teleoperation.frame_source import camera_frames, film_frames
from softgrip_design.teleoperation.session import DeadManSwitch, TeleoperationFrame, TeleoperationSession
from softgrip_design.teleoperation.tendon_table import TendonBounds, TendonTable
from softgrip_design.teleoperation.terminal import TerminalKeys
from softgrip_model.finger import Finger, FingerError
from softgrip_model.finger.predictor import assumed_friction
from softgrip_model.profile import ProfileError, load_directory, shipped_directory
from softgrip_nodekit import make_executor

EPILOG = f"""\
SOURCE is `camera`, `camera:1`, a video file, or a folder of images. A film runs by the cell's time.
Each finger follows the hand's finger of the same name: the hand's joint angles beyond the open hand are added up, and
the tendon is pulled as far as the mounted finger needs for the same sum (with the friction model that is active).

Show the open hand first. Nothing moves unless the dead-man switch is held:
  SPACE   held down in this terminal; the fingers stand within 0.2 s when it is let go
  a pedal publishes teleoperation/dead_man (std_msgs/Bool, true), 20 times a second or more, while it is pressed
ENTER ends a demonstration as a success, x as a failure, q ends the program. The fingers stay where they are.

Needs homed tendons (--home) that nobody else works with; they are leased meanwhile. With a recorder running,
`ros2 run softgrip_bag export --lerobot OUT BAG` makes an episode of each demonstration.
MediaPipe is an extra:  {INSTALL}

examples:
  ros2 run softgrip_design teleoperate camera --home --task "pick up the apple"
  ros2 run softgrip_design teleoperate grasps.mp4 --tendons index --record
"""
#: Exit codes.
ENDED, CANNOT = 0, 2
CONSOLE = Console(stderr=True, highlight=False, soft_wrap=True)


def parser() -> argparse.ArgumentParser:
    """Return the command line's parser."""
    bounds, follower = TendonBounds(), FollowerSettings()
    made = argparse.ArgumentParser(
        prog="ros2 run softgrip_design teleoperate",
        description=__doc__,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    made.add_argument("source", metavar="SOURCE", help="camera, camera:N, video, or folder of images")
    made.add_argument("--task", default="Follow the hand", help="what is shown, in words (default: %(default)s)")
    made.add_argument("--tendons", nargs="+", default=[], metavar="NAME", help="default: all called after a finger")
    made.add_argument("--profile", default="", help="finger set that is mounted; default: as cell/state says")
    made.add_argument("--profiles", type=Path, metavar="FOLDER", help="of finger sets; default: the shipped ones")
    made.add_argument("--home", action="store_true", help="home the tendons first")
    made.add_argument(
        "--record", nargs="?", const="", default=None, metavar="PATH", help="have the recorder write a bag of its own"
    )
    made.add_argument("--rate", type=float, default=30.0, metavar="HZ", help="of images (default: %(default)s)")
    clamps = made.add_argument_group("clamps")
    clamps.add_argument(
        "--max-length", type=float, default=bounds.max_length_m, metavar="M", help="default: %(default)s"
    )
    clamps.add_argument(
        "--max-tension",
        type=float,
        default=bounds.max_tension_n,
        metavar="N",
        help="predicted for the empty finger (default: %(default)s); the driver's own limit stays",
    )
    clamps.add_argument(
        "--max-speed", type=float, default=follower.max_speed_m_s, metavar="M/S", help="default: %(default)s"
    )
    return made


def main(args: Sequence[str] | None = None) -> int:
    """Run the command: 0 at the end of the film or with q, 2 when it could not begin or go on."""
    command_line = sys.argv if args is None else ["teleoperate", *args]
    options = parser().parse_args(remove_ros_args(command_line)[1:])
    for name in ("max_length", "max_tension", "max_speed", "rate"):
        if not (math.isfinite(getattr(options, name)) and getattr(options, name) > 0.0):
            parser().error(f"expected --{name.replace('_', '-')} above 0, found {getattr(options, name)}")
    try:
        with MediaPipeDetector() as detector:
            return teleoperate(options, detector, command_line)
    except (DesignError, FingerError, ProfileError, OSError) as error:
        CONSOLE.print(f"teleoperate: {error}", markup=False)
        return CANNOT
    except KeyboardInterrupt:
        return ENDED


def teleoperate(options: argparse.Namespace, detector: HandDetector, command_line: Sequence[str] = ()) -> int:
    """Do what the command does, with the given detector.

    Raises:
        DesignError: no cell, no hand film, tendons of somebody else.
    """
    rclpy.init(args=list(command_line))
    node = Node("teleoperate")
    executor = make_executor(node)
    executor.add_node(node)
    spinner = threading.Thread(target=_spin, args=(executor,), name="callbacks", daemon=True)
    spinner.start()
    try:
        return lead(options, detector, node)
    finally:
        executor.shutdown()
        spinner.join(2.0)
        node.destroy_node()
        rclpy.try_shutdown()


def _spin(executor: rclpy.executors.Executor) -> None:
    try:
        executor.spin()
    except ExternalShutdownException:
        return


def lead(options: argparse.Namespace, detector: HandDetector, node: Node) -> int:
    """Lead the fingers through a node that another thread spins.

    Raises:
        DesignError: as `teleoperate`.
    """
    switch, demonstrations, ended = DeadManSwitch(), Demonstrations(), threading.Event()
    link = FingerLink(node, switch, options.max_tension, options.task)
    link.await_cell(options.tendons)
    if options.home:
        link.home()
    link.check_homed()
    bounds = TendonBounds(options.max_length, options.max_tension)
    follower = HandFollower(_tables(options, link, bounds), FollowerSettings(max_speed_m_s=options.max_speed))
    frames = _frames(options, link.cell_time_s, ended.is_set)
    keys = TerminalKeys(_key_actions(switch, demonstrations, ended))
    with ExitStack() as stack:
        if options.record is not None:
            stack.enter_context(link.recorded(options.record))
        stack.enter_context(link.leased())
        stack.enter_context(keys)
        session = TeleoperationSession(_Shown(link), follower, detector, switch, demonstrations)
        count = session.run(frames, ended.is_set)
    number, _ = demonstrations.current
    CONSOLE.print(
        f"{count} frames, {number} demonstrations" + (f"; bag: {link.recorded_path}" if link.recorded_path else "")
    )
    return ENDED


def _tables(options: argparse.Namespace, link: FingerLink, bounds: TendonBounds) -> dict[str, TendonTable]:
    """Return tendon -> table, of the fingers that are mounted and the friction that is active."""
    profiles = load_directory(options.profiles or shipped_directory())
    mounted = dict.fromkeys(link.tendons, options.profile) if options.profile else link.mounted_profiles()
    law = link.active_friction()
    tables = {}
    for name in link.tendons:
        profile = profiles.get(mounted.get(name, ""))
        if profile is None:
            raise DesignError(
                f"{name}: expected a mounted finger of {', '.join(sorted(profiles))}, found "
                f"{mounted.get(name) or 'none'}; mount fingers (cell/swap), or name the set with --profile"
            )
        tables[name] = TendonTable(Finger.from_profile(profile, name), law or assumed_friction(profile).law, bounds)
    return tables


def _frames(
    options: argparse.Namespace, cell_time_s: Callable[[], float], is_ended: Callable[[], bool]
) -> Iterable[VideoFrame]:
    text: str = options.source
    if text == "camera" or text.startswith("camera:"):
        number = text.partition(":")[2] or "0"
        if not number.isdigit():
            raise DesignError(f"expected camera or camera:<number>, found {text!r}")
        return camera_frames(int(number), cell_time_s)
    path = Path(text)
    if not path.exists():
        raise DesignError(f"expected a film at {path}, found no such file")
    return film_frames(Images(path, options.rate) if path.is_dir() else Video(path), cell_time_s, is_ended)


def _key_actions(
    switch: DeadManSwitch, demonstrations: Demonstrations, ended: threading.Event
) -> Callable[[str], None]:
    def pressed(key: str) -> None:
        if key == " ":
            switch.press(time.monotonic())
        elif key in "\r\n":
            demonstrations.end(Phase.SUCCEEDED)
        elif key == "x":
            demonstrations.end(Phase.FAILED)
        elif key == "q":
            ended.set()

    return pressed


class _Shown:
    """A link that also says in the terminal what changes."""

    def __init__(self, link: FingerLink) -> None:
        self._link = link
        self._last: tuple[int, Phase, str] | None = None
        self.cell_time_s, self.lengths_m = link.cell_time_s, link.lengths_m
        self.find_problem, self.order = link.find_problem, link.order

    def show(self, frame: TeleoperationFrame) -> None:
        """Publish what became of a frame, and print what is new."""
        self._link.show(frame)
        state = (frame.episode, frame.phase, frame.reason)
        if state != self._last:
            self._last = state
            number = f"{frame.episode} {frame.phase.name.lower()}: " if frame.episode else ""
            CONSOLE.print(f"{number}{frame.reason or 'following'}", markup=False)


if __name__ == "__main__":
    sys.exit(main())
