"""``morlnav-export RUN_DIR``: a trained policy as ONNX and ``torch.export`` files, its preference still adjustable."""

from __future__ import annotations

import argparse
import io
import json
from importlib.util import find_spec
from pathlib import Path

import torch
from torch.export import Dim, ExportedProgram

from morlnav.cli import folder, one_sentence_errors, quiet, writable
from morlnav.deployment.policy import Policy, load
from morlnav.files import write_bytes
from morlnav.modules.checks import check_weights

FORMATS = ("onnx", "pt2")


def export_program(policy: Policy) -> ExportedProgram:
    """The policy as a ``torch.export`` program for batches of any size, which answers senseless inputs with a stop.

    Args:
        policy: as :func:`morlnav.load` gives it.

    Returns:
        A program from ``observation`` ``[B, D]`` (m, rad) and ``preference`` ``[B, n]`` to ``action`` ``[B, 2]`` (m/s,
        rad/s).

    Examples:
        >>> program = export_program(morlnav.load("results/default"))  # doctest: +SKIP
        >>> program.module()(torch.zeros(1, 34), torch.tensor([[0.2, 0.3, 0.5]])).shape  # doctest: +SKIP
        torch.Size([1, 2])
    """
    example = torch.zeros(2, policy.actor.features.in_features), torch.zeros(2, len(policy.objectives))
    batch = Dim("batch", min=1)
    return torch.export.export(policy, example, dynamic_shapes=({0: batch}, {0: batch}))


def export_policy(policy: Policy, directory: str | Path, formats: tuple[str, ...] = FORMATS) -> dict[str, Path]:
    """Write the policy for use without this package.

    Both files map ``observation`` ``[B, D]`` and ``preference`` ``[B, n]`` to ``action`` ``[B, 2]``, a stop where one
    makes no sense. The names of the preference's entries are the ONNX file's metadata ``objectives``, a JSON list, and
    the extra file ``objectives`` of the ``torch.export`` archive.

    Args:
        policy: as :func:`morlnav.load` gives it.
        directory: where ``policy.onnx`` and ``policy.pt2`` go; made if it does not exist.
        formats: which of ``"onnx"`` and ``"pt2"``.

    Returns:
        The files by format.

    Raises:
        OSError: if the disk has too little room.
        ValueError: for an unknown format, weights that are not finite, or if ONNX is asked for and its packages are
            missing.
    """
    unknown = set(formats) - set(FORMATS)
    if unknown:
        raise ValueError(f"There is no format {', '.join(sorted(unknown))}; choose from: {', '.join(FORMATS)}.")
    if "onnx" in formats and find_spec("onnxscript") is None:  # what PyTorch's exporter needs
        raise ValueError("ONNX needs more packages: pip install 'morlnav[export]', or choose --format pt2.")
    check_weights(policy, "This policy")
    directory = writable(Path(directory))
    directory.mkdir(parents=True, exist_ok=True)
    program, objectives = export_program(policy), json.dumps(policy.objectives)
    files = {form: directory / f"policy.{form}" for form in formats}
    if "onnx" in files:
        _write_onnx(program, files["onnx"], objectives)
    if "pt2" in files:
        torch.export.save(program, content := io.BytesIO(), extra_files={"objectives": objectives})
        write_bytes(files["pt2"], content.getvalue())
    return files


def _write_onnx(program: ExportedProgram, path: Path, objectives: str) -> None:
    exported = torch.onnx.export(
        program,
        input_names=["observation", "preference"],
        output_names=["action"],
        dynamo=True,
        external_data=False,
        verbose=False,
    )
    exported.model.metadata_props["objectives"] = objectives
    write_bytes(path, exported.model_proto.SerializeToString())


def main() -> None:
    """Entry point."""
    quiet()
    parser = argparse.ArgumentParser(prog="morlnav-export", description=__doc__.split(": ", 1)[1])
    parser.add_argument("run", type=Path, metavar="RUN_DIR", help="a run directory of morlnav-train")
    parser.add_argument("--output", type=folder, help="where the files go (default: RUN_DIR/export)")
    parser.add_argument("--format", choices=FORMATS, action="append", help="only this one; may be repeated")
    parser.add_argument("--trust", action="store_true", help="build classes from outside morlnav that the run names")
    args = parser.parse_args()
    with one_sentence_errors(own_classes=True):
        policy = load(args.run, trust=args.trust)
        files = export_policy(policy, args.output or args.run / "export", tuple(args.format or FORMATS))
    print(f"{', '.join(map(str, files.values()))}: observation [B, {policy.actor.features.in_features}] and preference")
    print(f"[B, {len(policy.objectives)}] ({', '.join(policy.objectives)}) to action [B, 2] in m/s and rad/s.")


if __name__ == "__main__":
    main()
