import pytest
import torch

from morlnav import NavigationEnv
from morlnav.navigation.modules import CircumnavigationOracle, MirrorImage, PassingOracle
from morlnav.navigation.world import SceneSampler, without_human


def scenes_and_mirrors(n=16):
    scenes = SceneSampler()(n, generator=torch.Generator().manual_seed(0))
    mirrors = scenes.clone()
    mirrors.boxes[..., 4] *= -1
    for position in (mirrors.start[..., 1:], mirrors.goal[..., 1], mirrors.human[..., 1], mirrors.boxes[..., 1]):
        position *= -1
    return scenes, mirrors


@pytest.mark.parametrize("oracle", [CircumnavigationOracle, PassingOracle])
def test_the_mirror_image_of_a_driver_passes_on_the_other_side(oracle):
    env = NavigationEnv(num_envs=16, seed=0)
    observation = env.rollout(20)["observation"]
    right, left = oracle(clockwise=True), oracle(clockwise=False)
    mirrored = MirrorImage()(lambda observation, preference: right(observation), observation, torch.rand(16, 20, 2))
    assert torch.allclose(mirrored, left(observation), atol=1e-4)


@pytest.mark.parametrize("human", [True, False])
def test_it_sees_what_a_robot_in_the_mirrored_scene_sees(human):
    seen, env = [], NavigationEnv(num_envs=16, seed=0)
    scenes, mirrors = scenes_and_mirrors()
    observation, mirrored = (env.reset(scene=scene)["observation"] for scene in (scenes, mirrors))
    if not human:
        observation, mirrored = without_human(observation), without_human(mirrored)
    driver = lambda observation, preference: (seen.append(observation), torch.ones(16, 2))[1]  # noqa: E731
    action = MirrorImage(observe_human=human)(driver, observation, torch.rand(16, 2))
    assert ((seen[0] - mirrored).abs() < 0.05).float().mean() > 0.97  # rays lie half a degree from their images
    assert action.tolist() == [[1.0, -1.0]] * 16
