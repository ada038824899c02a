"""Where it is driven."""

import torch
from torchrl.envs import Transform

from morlnav.navigation.envs import NavigationEnv
from morlnav.navigation.world import SceneSampler, TensorWorld
from swapper.marks import mark


class Corridor(NavigationEnv):
    def _step(self, tensordict):
        mark(self)
        return super()._step(tensordict)


class SlipperyWorld(TensorWorld):
    def __init__(self, grip=0.8, **settings):
        super().__init__(**settings)
        self.grip = grip

    def step(self, action):
        mark(self)
        return super().step(action * action.new_tensor([1.0, self.grip]))


class Crowded(SceneSampler):
    def __call__(self, *args, **settings):
        mark(self)
        return super().__call__(*args, **settings)


class Calm:
    def __init__(self, penalty: float = -10.0):
        self.penalty = penalty

    def __call__(self, transition):
        mark(self)
        return self.penalty * transition.action[:, 1].abs() / torch.pi

    def bounds(self, reach):
        return self.penalty, 0.0


class Watched(Transform):
    def _step(self, tensordict, next_tensordict):
        mark(self)
        return next_tensordict
