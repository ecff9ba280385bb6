# SPDX-License-Identifier: Apache-2.0
"""Tips of the URDF, moved as /joint_states moves it and read by MuJoCo, beside 1,000 random states of every finger.

States of finger/predicted in modes F and P and of fingers that have learnt, of the recipe of mode R, and of
finger/measured. Then the middles of the links beside the kernel's own, along a free closing in steps of 0.1 mm, by the
profile's friction and by others: what a tip that is met does not say.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from softgrip_description import finger_joint_names, shipped_hand, slot_pose, urdf_of
from softgrip_description.pose_feed import HandPose
from softgrip_model.finger import Finger, FingerError, JointModel, Plane, follow
from softgrip_model.finger.learning import Knowledge
from softgrip_model.finger.predictor import Configuration, Prediction, assumed_friction
from softgrip_model.finger.replication import replicate
from softgrip_model.finger.uncertainty import PRIOR
from softgrip_model.friction.laws import FrictionLaw, Law
from softgrip_model.profile import Profile, load_directory, shipped_directory
from softgrip_testing.benchmark_claim import claim, no_options
from softgrip_vision.chain import ChainFilter, ChainGeometry
from softgrip_vision.layout import ChainLayout

Array = NDArray[np.float64]
#: Joint angles (n,) [rad] and tip (2,) [m], as a message has them.
State = tuple[Array, Array]

STATES = 1000
MAX_PULLED_M = 0.015
#: Fingers, each another one, that a learning finger is taken for.
LEARNT = 20
#: Pulled lengths [mm] at which the links' middles are compared.
PULLED_MM = np.arange(0.1, 1e3 * MAX_PULLED_M + 0.05, 0.1)
#: Coefficients of the Capstan law beside the profile's friction.
OTHER_FRICTIONS = (0.1, 0.6)
#: [mm] further away than any finger reaches: a plane that no link touches.
FAR_MM = 1e4


class DescribedFinger:
    """A finger of a described hand, read by MuJoCo.

    Args:
        profile: of all fingers of the hand.
        slot: of the finger.
    """

    def __init__(self, profile: Profile, slot: str) -> None:
        hand = shipped_hand()
        self._slot, self._design = slot, profile.finger(slot)
        self._base, self._palm_m = slot_pose(hand.slots[slot]), np.array(hand.flange_position_m)
        self._pose = HandPose(hand, {profile.id: profile})
        self._pose.set_mounted(dict.fromkeys(profile.slots, profile.id))
        self._model = mujoco.MjModel.from_xml_string(urdf_of(hand, self._pose.fingers))
        self._data = mujoco.MjData(self._model)

    def difference(self, state: State, *, hinges: bool = False) -> tuple[float, float]:
        """Return how far position [m] and direction [rad] of the described tip are from a state's.

        Args:
            state: as the message has it.
            hinges: whether only the joints that turn are moved.
        """
        angles, tip = state
        self._move(state, hinges=hinges)
        # MuJoCo merges links without joints into their parents: the tip is the last link's end
        last = self._data.body(f"{self._slot}_link_{self._design.joints - 1}")
        rotation = last.xmat.reshape(3, 3)
        found = last.xpos + rotation @ [self._design.link_lengths_m[-1], 0.0, 0.0] - self._palm_m
        expected = (self._base @ [*tip, 0.0, 1.0])[:3]
        total = float(np.sum(angles))
        along = self._base[:3, :3] @ [math.cos(total), -math.sin(total), 0.0]
        return float(np.linalg.norm(found - expected)), float(np.linalg.norm(np.cross(rotation[:, 0], along)))

    def middles(self, state: State, *, hinges: bool = False) -> Array:
        """Return where the middles of the links are, (n, 2) [m] in ``<finger>_base``.

        Args:
            state: as the message has it.
            hinges: whether only the joints that turn are moved.
        """
        self._move(state, hinges=hinges)
        found = []
        for j, length in enumerate(self._design.link_lengths_m):
            link = self._data.body(f"{self._slot}_link_{j}")
            at = link.xpos + link.xmat.reshape(3, 3) @ [0.5 * length, 0.0, 0.0] - self._palm_m
            found.append((np.linalg.inv(self._base) @ [*at, 1.0])[:2])
        return np.array(found)

    def _move(self, state: State, *, hinges: bool) -> None:
        angles, tip = state
        self._pose.set_finger(self._slot, angles.tolist(), tip.tolist())
        turning = finger_joint_names(self._slot, self._design.joints)
        for name, position in zip(*self._pose.joint_state(), strict=True):
            self._data.joint(name).qpos = position if name in turning or not hinges else 0.0
        mujoco.mj_kinematics(self._model, self._data)


def kernel_middles(profile: Profile, slot: str, law: FrictionLaw) -> list[tuple[State, Array]]:
    """Return states of a free closing with the kernel's own middles of the links, (n, 2) [m].

    How far a link's middle is from a plane that it never touches is where it is.
    """
    finger = Finger.from_profile(profile, slot)
    x, y = (
        follow(
            finger,
            law,
            PULLED_MM,
            contacts=[Plane(normal, -FAR_MM, j, 0.5 * length) for j, length in enumerate(finger.link_mm)],
        )
        for normal in ((1.0, 0.0), (0.0, 1.0))
    )
    known = ~(x.failed | y.failed)
    middles = 1e-3 * (np.stack([x.gap[known], y.gap[known]], axis=-1) - FAR_MM)
    states = zip(x.angle_rad[known], 1e-3 * x.tip_mm[known], strict=True)
    return list(zip(states, middles, strict=True))


def middle_differences(profile: Profile, slot: str, described: DescribedFinger) -> dict[str, Array]:
    """Return how far the described middles are at most from the kernel's, by the friction of the closing.

    Each (2,) [m]: of the links before the last, and of the last. A finger that the kernel can not compute has none.
    """
    laws = {"the profile's friction": assumed_friction(profile).law}
    laws |= {f"Capstan, mu {mu}": FrictionLaw(Law.CAPSTAN, (mu,), 2.0) for mu in OTHER_FRICTIONS}
    found = {}
    for name, law in laws.items():
        try:
            pairs = kernel_middles(profile, slot, law)
        except FingerError:
            continue
        for hinges in (False, True) if law is laws["the profile's friction"] else (False,):
            apart = np.array([np.linalg.norm(described.middles(one, hinges=hinges) - at, axis=1) for one, at in pairs])
            row = "revolute joints alone" if hinges else name
            found[row] = np.array([apart[:, :-1].max(initial=0.0), apart[:, -1].max(initial=0.0)])
    return found


def predicted(profile: Profile, slot: str, draw: np.random.Generator, joint_model: JointModel) -> list[State]:
    """Return states of finger/predicted."""
    configuration = Configuration({profile.id: profile}, {slot: profile.id}, None, joint_model)
    return _states(configuration.closing(slot, draw.uniform(0.0, MAX_PULLED_M, STATES).tolist()))


def learnt(profile: Profile, slot: str, draw: np.random.Generator) -> list[State]:
    """Return states of finger/predicted of fingers that differ from their profile's by their uncertainty."""
    configuration = Configuration({profile.id: profile}, {slot: profile.id}, None)
    prior = Knowledge.prior(configuration.causes(slot, PRIOR))
    states = []
    for _ in range(LEARNT):
        known = dataclasses.replace(prior, mean=draw.standard_normal(len(prior.mean)))
        pulled_length_m = draw.uniform(0.0, MAX_PULLED_M, STATES // LEARNT).tolist()
        states += _states(configuration.closing(slot, pulled_length_m, known))
    return states


def replicated(profile: Profile, slot: str) -> list[State]:
    """Return the states along a closing by the thesis' recipe, with the tip of rigid links."""
    finger = Finger.from_profile(profile, slot, JointModel.HINGE)
    replica = replicate(finger, assumed_friction(profile).law, 1e3 * MAX_PULLED_M, STATES)
    angles = replica.angle_rad[np.isfinite(replica.angle_rad).all(axis=1)]
    tips = np.exp(-1j * np.cumsum(angles, axis=1)) @ profile.finger(slot).link_lengths_m
    return [(angle, np.array([tip.real, tip.imag])) for angle, tip in zip(angles, tips, strict=True)]


def measured(profile: Profile, slot: str, draw: np.random.Generator) -> list[State]:
    """Return states of finger/measured: its filter over markers that lie 0.1 mm beside those of random angles."""
    design = profile.finger(slot)
    geometry = ChainGeometry(ChainLayout(design.link_lengths_m), 0.020)
    states = []
    for _ in range(STATES):
        chain = ChainFilter(geometry)
        state = np.zeros(3 + 2 * design.joints)
        state[3 : 3 + design.joints] = draw.uniform(0.0, 0.9, design.joints) * np.array(design.openings_rad)
        markers = geometry.markers(state)
        chain.place(markers + draw.normal(0.0, 1e-4, markers.shape))
        states.append((chain.angles()[0].copy(), chain.tip()[0].copy()))
    return states


def _states(predictions: list[Prediction]) -> list[State]:
    return [(one.joint_angles, np.array(one.tip)) for one in predictions if math.isfinite(one.tip[0])]


def states(profile: Profile, slot: str, draw: np.random.Generator) -> Iterator[tuple[str, list[State]]]:
    """Yield the name of each source with its states."""
    yield "mode F", predicted(profile, slot, draw, JointModel.FLEXURE)
    yield "mode F, learnt", learnt(profile, slot, draw)
    yield "mode P", predicted(profile, slot, draw, JointModel.HINGE)
    yield "mode R", replicated(profile, slot)
    yield "measured", measured(profile, slot, draw)


def main() -> None:
    """Compare and print the claims."""
    no_options(__doc__)
    draw = np.random.default_rng(20261123)
    largest: dict[str, Array] = {}
    middles: dict[str, Array] = {}
    hinge_m, runs = 0.0, 0
    for profile in load_directory(shipped_directory()).values():
        for slot in profile.slots:
            described = DescribedFinger(profile, slot)
            for source, some in states(profile, slot, draw):
                found = np.array([described.difference(state) for state in some])
                largest[source] = np.maximum(largest.get(source, 0.0), found.max(axis=0))
                runs += len(some)
                if source == "mode F":
                    hinge_m = max(hinge_m, *(described.difference(state, hinges=True)[0] for state in some))
            for friction, apart in middle_differences(profile, slot, described).items():
                middles[friction] = np.maximum(middles.get(friction, 0.0), apart)
    position_m, direction_rad = np.max(list(largest.values()), axis=0)
    each = "; ".join(f"{source}: {m:.1e} m, {rad:.1e} rad" for source, (m, rad) in largest.items())
    note = f"largest of {STATES} random states of each finger and source, up to 15 mm pulled, MuJoCo reads: {each}"
    common: dict[str, Any] = {"better": "lower", "runs": runs, "note": note}
    peer: dict[str, Any] = {"peer": "joints that turn alone, mode F", "peer_value": hinge_m}
    claim("tip difference", float(position_m), "m", goal=1e-5, **common, **peer)
    claim("tip direction difference", float(direction_rad), "rad", goal=1e-6, **common)
    each = "; ".join(
        f"{friction}: {1e3 * m:.3f} mm, last {1e3 * last:.3f} mm" for friction, (m, last) in middles.items()
    )
    own = middles["the profile's friction"]
    claim(
        "middle of a link, difference",
        float(own.max()),
        "m",
        better="lower",
        goal=None,
        runs=len(PULLED_MM),
        note=f"largest of all shipped fingers, every 0.1 mm up to 15 mm pulled, beside the kernel's own: {each}",
        peer="joints that turn alone",
        peer_value=float(middles["revolute joints alone"].max()),
    )


if __name__ == "__main__":
    main()
