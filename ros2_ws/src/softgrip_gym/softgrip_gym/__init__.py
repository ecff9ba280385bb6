# SPDX-License-Identifier: Apache-2.0
"""The emulated cell as Gymnasium environments: importing this registers them.

    import gymnasium
    import softgrip_gym

    env = gymnasium.make("softgrip/GraspProduct-v0", finger_set="power", products=("apple", "egg"))
    many = gymnasium.make_vec("softgrip/FingerReach-v0", num_envs=2, vectorization_mode="async")

Observations are what tendon/state carries, actions what tendon/trajectory takes: a policy meets the same driver,
servos, fingers and products as in the live emulated cell. docs/virtual.md describes rewards and draws.
"""

import gymnasium

from softgrip_gym.finger_reach import FingerReach
from softgrip_gym.grasp_policy import GraspPolicy
from softgrip_gym.grasp_product import GraspProduct

__all__ = ["FingerReach", "GraspPolicy", "GraspProduct"]

gymnasium.register("softgrip/FingerReach-v0", entry_point="softgrip_gym.finger_reach:FingerReach")
gymnasium.register("softgrip/GraspProduct-v0", entry_point="softgrip_gym.grasp_product:GraspProduct")
