"""Updates per second at one set of shapes, against other learners and against the limit of the matrix products."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import gymnasium
import torch
from omegaconf import DictConfig
from torch import Tensor

from benchmarks.limit import matrix_product, update_flops
from benchmarks.peers import libraries
from benchmarks.peers.minimal_td3 import MinimalTD3
from benchmarks.peers.pd_morl import PDMORL
from benchmarks.recipes import Networks, filled_trainer, networks, recipe
from benchmarks.timing import Contender, Effort, Row, race
from morlnav.navigation.envs import ENV_ID, Efficiency, default_objectives
from morlnav.trainers.haste import product_dtype

TITLE = "Learner: updates with batches of 256, networks of 4×256, 4 objectives, 34 observed numbers"
NOTES = """Unit: updates, of both critics each time and of the actor every second time (CAPQL: every time, PD-MORL:
every tenth). morlnav's rows are `Trainer.optim_steps` of the trainer that `morlnav-train` runs, with sampling,
relabelling, clipping, both Adam steps, targets, the averaged actor and learning-rate schedules: *plain* without angle
term, guidance, search and afterstate, and with exact products, as all peers have them;
*plain, as shipped* with the products that `products=auto` chooses; *default* also with all the rest, as
recommended. *Minimal* is plain PyTorch on the same networks, twins one after the other, without averaging and
schedules. TorchRL's stock TD3 sees one scalar reward, no preference, and the bare 34 numbers. CAPQL and GPI-LS are
morl-baselines' own code on our Gymnasium environment's shapes; GPI-LS doubles every batch to 512 rows. PD-MORL
inserts one transition four times per update. The limit is the rate of the fastest float32 matrix product found,
divided by the fewest operations that an update needs."""

SHAPES = (
    "actor.depth=4",
    "critic.depth=4",
    "replay.batch_size=256",
    "stepper.policy_update_delay=2",
)
PLAIN = (
    "loss.terms.angle=null",
    "loss.terms.proposals=null",
    "critic.afterstate=null",
)
EXACT = "products=float32"


def measure(effort: Effort) -> list[Row]:
    """Race all learners."""
    frames = 256 if effort.quick else 10_000
    cfg = recipe(effort, *SHAPES)  # with the angle term, guidance by a clone, search and afterstate
    shipped = recipe(effort, *SHAPES, *PLAIN)
    plain = recipe(effort, *SHAPES, *PLAIN, EXACT)
    updates = cfg.trainer.optim_steps_per_batch
    same, rows = networks(plain), random_rows(frames, device=effort.device)
    delay = plain.stepper.policy_update_delay
    flops = update_flops(same.actor, same.critics[0], plain.replay.batch_size, delay)
    product, worth = matrix_product(effort, flops)
    layers = [cfg.actor.num_cells] * cfg.actor.depth
    products = product_dtype(cfg.products, torch.device(effort.device))
    products = f"hidden layers multiply in {str(products).split('.')[1]}"
    contenders = [
        Contender("morlnav, plain", partial(optimisation, plain, frames), updates),
        Contender("morlnav, plain, as shipped", partial(optimisation, shipped, frames), updates, note=products),
        Contender("morlnav, default", partial(optimisation, cfg, frames), updates, note=products),
        Contender("minimal PyTorch TD3", lambda: minimal(same, rows, delay).step, peer=True),
        Contender("TorchRL TD3Loss, scalar", lambda: libraries.torchrl_td3(rows, *same.limits, layers), peer=True),
        Contender("PD-MORL", lambda: _pd_morl(networks(plain, all_tuneable=True), rows).step, peer=True),
        Contender("morl-baselines CAPQL", lambda: libraries.capql(_four_objectives(), rows, layers), peer=True),
        Contender("morl-baselines GPI-LS", lambda: libraries.gpi_ls(_four_objectives(), rows, layers), peer=True),
        Contender(
            "limit of the matrix products", lambda: product, worth, f"{flops / 1e9:.2f} GFLOP per update", ours=False
        ),
    ]
    return race("learner", "4×256, 4 objectives", "updates/s", contenders, effort)


def optimisation(cfg: DictConfig, frames: int) -> Callable[[], object]:
    """One round of optimisation steps, ``optim_steps_per_batch`` of them, exactly as the trainer makes it."""
    trainer, _ = filled_trainer(cfg, frames)
    return lambda: trainer.optim_steps(None)


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


def minimal(parts: Networks, rows: dict[str, Tensor], delay: int = 2) -> MinimalTD3:
    """The hand-written learner on these networks."""
    return MinimalTD3(parts.actor, parts.critics, rows, *parts.limits, parts.num_objectives, delay=delay)


def _pd_morl(parts: Networks, rows: dict[str, Tensor]) -> PDMORL:
    return PDMORL(parts.actor, parts.critics, rows, *parts.limits)
