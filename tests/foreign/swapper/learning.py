"""How it is learned."""

import torch
from torch.optim.lr_scheduler import LambdaLR
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, RandomSampler
from torchrl.envs import Transform
from torchrl.modules import AdditiveGaussianModule
from torchrl.objectives import SoftUpdate
from torchrl.record import CSVLogger
from torchrl.trainers.trainers import TrainerHookBase

from morlnav.data import PreferenceSampler, UniformPreferences
from morlnav.navigation.evaluation import NavigationEvaluation
from morlnav.trainers import MORLTD3Stepper, MORLTrainer, PathwiseRefinement
from swapper.marks import mark


class Floored(PreferenceSampler):
    def __init__(self, num_objectives: int, floor: float = 0.1):
        super().__init__(num_objectives)
        self.floor, self.uniform = floor, UniformPreferences(num_objectives)

    def __call__(self, *batch_size, device=None, generator=None):
        mark(self)
        rest = 1 - self.num_objectives * self.floor
        return self.floor + rest * self.uniform(*batch_size, device=device, generator=generator)


class Halved(Transform):
    def __init__(self):
        super().__init__(in_keys=[("next", "reward")], out_keys=[("next", "reward")])

    def _apply_transform(self, reward):
        mark(self)
        return reward / 2


class Recent(RandomSampler):
    def sample(self, storage, batch_size):
        mark(self)
        return super().sample(storage, batch_size)


class Shelf(LazyTensorStorage):
    def set(self, *args, **settings):
        mark(self)
        return super().set(*args, **settings)


class Shaky(AdditiveGaussianModule):
    def forward(self, tensordict):
        mark(self)
        return super().forward(tensordict)


class Careful(torch.optim.Adam):
    def step(self, closure=None):
        mark(self)
        return super().step(closure)


def halving(optimizer, total_steps):
    mark("halving")
    return LambdaLR(optimizer, lambda step: 0.5 ** (step / total_steps))


class Slow(SoftUpdate):
    def step(self):
        mark(self)
        return super().step()


class Stepper(MORLTD3Stepper):
    def step(self, trainer, sub_batch):
        mark(self)
        return super().step(trainer, sub_batch)


class Gatherer(Collector):
    def rollout(self):
        mark(self)
        return super().rollout()


class Teacher(MORLTrainer):
    def train(self):
        mark(self)
        return super().train()


class Polish(PathwiseRefinement):
    def __call__(self, policy, gamma=1.0, logger=None):
        mark(self)
        return super().__call__(policy, gamma, logger)


class Count(TrainerHookBase):
    def __call__(self):
        mark(self)

    def register(self, trainer, name="count"):
        trainer.register_op("post_steps", self)

    def state_dict(self):
        return {}

    def load_state_dict(self, state_dict):
        pass


class Lines(CSVLogger):
    def log_scalar(self, *args, **settings):
        mark(self)
        return super().log_scalar(*args, **settings)


class Wide(NavigationEvaluation):
    def measure(self, policy, episodes, steps):
        mark(self)
        return super().measure(policy, episodes, steps) | {"mine": 1.0}
