# SPDX-License-Identifier: Apache-2.0
"""The environments: Gymnasium's own checker, seeds, what a step does, and a policy from the file."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

pytest.importorskip("gymnasium", reason="make study-setup")
import gymnasium
from gymnasium.utils.env_checker import check_env

from softgrip_gym import FingerReach, GraspPolicy, GraspProduct
from softgrip_gym.commands import train as command
from softgrip_gym.cross_entropy import TrainingSettings, run_episode, train
from softgrip_gym.tendons import MAX_LENGTH_M, MAX_RATE_M_S, PERIOD_S, SLOTS, next_targets, tendon_observation

NAMES = ("softgrip/FingerReach-v0", "softgrip/GraspProduct-v0")


def rolled(env, seed, steps=12):
    """Observations and rewards of an episode's beginning with drawn actions."""
    rng = np.random.default_rng(7)
    observation, _ = env.reset(seed=seed)
    found = [observation]
    for _ in range(steps):
        observation, reward, *_ = env.step(rng.uniform(-1.0, 1.0, env.action_space.shape).astype(np.float32))
        found.append(np.append(observation, reward))
    return np.concatenate(found)


@pytest.mark.parametrize("name", NAMES)
def test_gymnasium_has_nothing_to_complain_about(name):
    check_env(gymnasium.make(name).unwrapped, skip_render_check=True)


@pytest.mark.parametrize("kind", [FingerReach, GraspProduct])
def test_a_seed_gives_the_same_episode_and_another_one_another(kind):
    first = rolled(kind(), 3)
    env = kind()
    rolled(env, 4, steps=3)
    assert np.array_equal(first, rolled(env, 3))
    assert not np.array_equal(first, rolled(env, 5))


def test_a_vector_of_environments_steps_as_each_of_them():
    many = gymnasium.make_vec(NAMES[0], num_envs=2, vectorization_mode="sync")
    together, _ = many.reset(seed=[3, 4])
    for row, seed in enumerate((3, 4)):
        assert np.array_equal(together[row], FingerReach().reset(seed=seed)[0])
    many.close()


def test_a_tendon_follows_its_command_as_far_as_the_driver_lets_it():
    env = GraspProduct()
    env.reset(seed=1, options={"cell": 1, "copy": 1, "product": "grape"})
    for _ in range(6):
        observation, *_ = env.step(np.array([0.5, 0.0, -1.0], np.float32))
    commanded_m, pulled_length_m = MAX_LENGTH_M * observation[9:12], MAX_LENGTH_M * observation[0:3]
    assert commanded_m == pytest.approx([6 * 0.5 * MAX_RATE_M_S * PERIOD_S, 0.0, 0.0], abs=1e-7)
    # it lags by the servo's following error and by one period of the stream
    assert pulled_length_m == pytest.approx(commanded_m, abs=1.5e-3)


def test_what_is_not_gripped_is_lost_when_the_arm_goes_up():
    env = GraspProduct(hold_s=1.0)
    env.reset(seed=1, options={"cell": 1, "product": "apple"})
    terminated, steps = False, 0
    while not terminated and steps < 200:
        _, reward, terminated, _, info = env.step(np.zeros(3, np.float32))
        steps += 1
    assert info["lost"]
    assert not info["is_success"]
    assert reward == 0.0
    assert steps * PERIOD_S == pytest.approx(2.5, abs=0.5)


def test_the_shipped_policy_holds_an_apple_in_a_cell_it_was_not_trained_in():
    reward, is_held = run_episode(GraspProduct(hold_s=2.0), GraspPolicy.load(), 1, {"cell": 1, "product": "apple"})
    assert is_held
    assert reward > 0.9


def test_a_policy_winds_until_the_tension_is_there():
    policy = GraspPolicy("power", (10.0, 0.0, 0.0), (5.0, 0.0, 0.0), 0.5)
    observation = np.zeros(17, np.float32)
    observation[:12] = tendon_observation([0.0] * 3, [0.0] * 3, [0.0, 10.0, 20.0], [0.0] * 3)
    assert policy.act(observation) == pytest.approx([0.5, 0.0, -0.1])


def test_targets_stay_within_travel_and_rate():
    start = np.array([0.0, 0.010, MAX_LENGTH_M])
    step = MAX_RATE_M_S * PERIOD_S
    assert next_targets(start, np.array([-5.0, 5.0, 1.0])) == pytest.approx([0.0, 0.010 + step, MAX_LENGTH_M])
    assert SLOTS == ("index", "middle", "thumb")


def test_training_gives_the_same_policy_with_one_and_two_workers():
    settings = TrainingSettings(products=("apple",), generations=1, policies=4, elite=2, episodes=1, hold_s=0.2)
    policies = []
    for workers in (1, 2):
        with ThreadPoolExecutor(workers) as pool:
            policies.append(train(settings, pool))
    assert policies[0] == policies[1]


def test_a_policy_file_comes_back_and_a_wrong_one_is_refused(tmp_path):
    policy = GraspPolicy("power", (1.0, 2.0, 3.0), (4.0, 5.0, 6.0), 0.5)
    path = tmp_path / "policy.json"
    policy.save(path)
    assert GraspPolicy.load(path) == policy
    for text in ("{", "[]", json.dumps({"kind": "other"}), path.read_text().replace("1.0", "NaN")):
        path.write_text(text)
        with pytest.raises(ValueError, match="expected"):
            GraspPolicy.load(path)


def test_wrong_settings_are_refused(capsys):
    with pytest.raises(ValueError, match="products"):
        GraspProduct(products=("brick",))
    with pytest.raises(SystemExit):
        command.main(["out.json", "--policies", "3"])
    assert "more than 4 policies" in capsys.readouterr().err
