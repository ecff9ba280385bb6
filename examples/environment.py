# SPDX-License-Identifier: Apache-2.0
"""Let a policy move a finger of the emulated cell: a Gymnasium environment (`make study-setup` first)."""

import gymnasium

import softgrip_gym  # noqa: F401  registers the environments

STEPS = 20


def main(seed: int = 1) -> list[float]:
    """Act at random for some steps; returns the rewards."""
    env = gymnasium.make("softgrip/FingerReach-v0")
    env.reset(seed=seed)
    env.action_space.seed(seed)
    rewards = []
    for _ in range(STEPS):
        _, reward, terminated, truncated, _ = env.step(env.action_space.sample())
        rewards.append(float(reward))
        if terminated or truncated:
            break
    env.close()
    print(f"{len(rewards)} steps, observation {env.observation_space.shape}, action {env.action_space.shape}")
    print(f"best reward {max(rewards):.3f}")
    return rewards


if __name__ == "__main__":
    main()
