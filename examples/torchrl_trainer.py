"""TorchRL's stock TD3Trainer with morlnav's environment, loss and relabelling, by config alone.

python examples/torchrl_trainer.py                          # some minutes
python examples/torchrl_trainer.py frames=2000 replay.transform.share=0.75 +world@env.base_env.world=pymunk_world
"""

import hydra
from omegaconf import DictConfig
from torchrl.trainers.algorithms import TD3Trainer

import morlnav.configs  # noqa: F401  (registers morlnav's configs next to TorchRL's)


@hydra.main(config_path=".", config_name="torchrl_trainer", version_base=None)
def main(cfg: DictConfig) -> TD3Trainer:
    """Build the trainer that the config describes, and train."""
    trainer = hydra.utils.instantiate(cfg.trainer)
    trainer.train()
    return trainer


if __name__ == "__main__":
    main()
