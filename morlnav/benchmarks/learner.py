"""Updates per second at one set of shapes, against other learners and against the limit of the matrix products."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import gymnasium
import torch
from omegaconf import DictConfig
from torch import Tensor

from morlnav.benchmarks import neighbours
from morlnav.benchmarks.limit import matrix_product, update_flops
from morlnav.benchmarks.minimal_td3 import MinimalTD3
from morlnav.benchmarks.pd_morl import PDMORL
from morlnav.benchmarks.recipes import filled_trainer, recipe
from morlnav.benchmarks.timing import Contender, Effort, Row, race
from morlnav.modules import Actor, VectorCritic
from morlnav.navigation.envs import ENV_ID, Efficiency, NavigationEnv, default_objectives
from morlnav.trainers.builders import bounds_of, make_base_env, make_networks, product_dtype

TITLE = "Learner: updates with batches of 256, networks of 4×256, 4 objectives, 34 observed numbers"
NOTES = """Unit: updates, of both critics each time and of the actor every second time (CAPQL: every time, PD-MORL:
every tenth). morlnav's rows are `Trainer.optim_steps` of the trainer that `morlnav-train` runs, with sampling,
relabelling, clipping, both Adam steps, targets, the averaged actor and learning-rate schedules: *plain* without angle
term, guidance, search and afterstate, an actor that climbs one critic, and exact products, as all peers have them;
*plain, as shipped* with the products that `trainer.products=auto` chooses; *default* also with all the rest, as
recommended. *Minimal* is plain PyTorch on the same networks, twins one after the other, without averaging and
schedules. TorchRL's stock TD3 sees one scalar reward, no preference, and the bare 34 numbers. CAPQL and GPI-LS are
morl-baselines' own code on our Gymnasium environment's shapes; GPI-LS doubles every batch to 512 rows. PD-MORL
inserts one transition four times per update. The limit is the rate of the fastest float32 matrix product found,
divided by the fewest operations that an update needs."""

SHAPES = (
    "networks.actor.depth=4",
    "networks.critic.depth=4",
    "trainer.batch_size=256",
    "trainer.policy_update_delay=2",
)
PLAIN = (
    "loss.angle=none",
    "loss.guidance=null",
    "loss.search=null",
    "loss.actor_qvalue_nets=1",
    "networks.afterstate=null",
)
EXACT = "trainer.products=float32"


def measure(effort: Effort) -> list[Row]:
    """Race all learners."""
    frames = 1000 if effort.quick else 10_000
    cfg = recipe(effort, *SHAPES)  # with the angle term, guidance by a clone, search and afterstate
    shipped = recipe(effort, *SHAPES, *PLAIN)
    plain = recipe(effort, *SHAPES, *PLAIN, EXACT)
    updates = cfg.trainer.optim_steps_per_batch
    flops = limit_flops(plain)
    product, worth = matrix_product(effort, flops)
    env, rows = make_base_env(plain, num_envs=1), random_rows(frames, device=effort.device)
    layers = [cfg.networks.actor.num_cells] * cfg.networks.actor.depth
    products = f"hidden layers multiply in {str(product_dtype(cfg.trainer.products, env.device)).split('.')[1]}"
    contenders = [
        Contender("morlnav, plain", partial(optimisation, plain, frames), updates),
        Contender("morlnav, plain, as shipped", partial(optimisation, shipped, frames), updates, note=products),
        Contender("morlnav, default", partial(optimisation, cfg, frames), updates, note=products),
        Contender("minimal PyTorch TD3", lambda: _minimal(plain, env, rows).step, peer=True),
        Contender(
            "TorchRL TD3Loss, scalar", lambda: neighbours.torchrl_td3(rows, *action_limits(env), layers), peer=True
        ),
        Contender("PD-MORL", lambda: _pd_morl(plain, env, rows).step, peer=True),
        Contender("morl-baselines CAPQL", lambda: neighbours.capql(_four_objectives(), rows, layers), peer=True),
        Contender("morl-baselines GPI-LS", lambda: neighbours.gpi_ls(_four_objectives(), rows, layers), peer=True),
        Contender("limit of the matrix products", lambda: product, worth, f"{flops / 1e9:.2f} GFLOP per update"),
    ]
    return race("learner", "4×256, 4 objectives", "updates/s", contenders, effort)


def optimisation(cfg: DictConfig, frames: int) -> Callable[[], object]:
    """One round of optimisation steps, ``optim_steps_per_batch`` of them, exactly as the trainer makes it."""
    trainer, _ = filled_trainer(cfg, frames)
    return lambda: trainer.optim_steps(None)


def limit_flops(cfg: DictConfig) -> float:
    """The fewest operations of an update of the config's networks."""
    actor, critics = make_networks(cfg, make_base_env(cfg, num_envs=1))
    return update_flops(actor, critics[0], cfg.trainer.batch_size, cfg.trainer.policy_update_delay)


def random_rows(count: int, objectives: int = 4, device: str = "cpu") -> dict[str, Tensor]:
    """Transitions of the right shapes, for learners that do not drive here."""
    generator = torch.Generator().manual_seed(0)

    def draw(columns: int, scale: float = 1.0) -> Tensor:
        return (scale * torch.rand(count, columns, generator=generator)).to(device)

    return {
        "observation": draw(34, 4.0),
        "action": draw(2, 0.5),
        "reward": -draw(objectives),
        "next_observation": draw(34, 4.0),
        "terminated": draw(1) < 0.01,
    }


def _four_objectives() -> gymnasium.Env:
    """Our Gymnasium environment with a fourth objective."""
    return gymnasium.make(ENV_ID, objectives={**default_objectives(), "fourth": Efficiency()})


def _minimal(cfg: DictConfig, env: NavigationEnv, rows: dict[str, Tensor]) -> MinimalTD3:
    delay = cfg.trainer.policy_update_delay
    return MinimalTD3(*make_networks(cfg, env), rows, *action_limits(env), len(env.objectives), delay=delay)


def _pd_morl(cfg: DictConfig, env: NavigationEnv, rows: dict[str, Tensor]) -> PDMORL:
    """Networks whose preference has an entry for every objective: PD-MORL knows no static ones."""
    count, bounds = len(env.rewards), bounds_of(env)
    actor = Actor(count, **bounds, depth=cfg.networks.actor.depth)
    critics = [VectorCritic(count, count, **bounds, depth=cfg.networks.critic.depth) for _ in range(2)]
    return PDMORL(actor.to(env.device), [critic.to(env.device) for critic in critics], rows, *action_limits(env))


def action_limits(env: NavigationEnv) -> tuple[Tensor, Tensor]:
    """Least and largest action, on the environment's device."""
    return env.world.robot.action_low.to(env.device), env.world.robot.action_high.to(env.device)
