"""`glambda record mujoco:MODEL`: the QPs that another engine poses along its own motion."""

from __future__ import annotations

from pathlib import Path

from glambda.cli.app import terminal
from glambda.cli.streams import say

PREFIX = "mujoco:"


def recorded_models(
    labels: list[str],
    settings: list[str] | None,
    until: float | None,
    folder: Path,
    overwrite: bool = False,
) -> None:
    """Record MJCF models into `folder`, and tell what MuJoCo's own forces are worth.

    Raises ValueError for a setting that is not `rigid`, ImportError where MuJoCo is absent.
    """
    from glambda.cli.simulation import write_new
    from harness.engines.mujoco import record_mujoco
    from harness.judging.recorded_answers import recorded_answers
    from harness.progress import shown
    from harness.study.kept_recording import kept_recording
    from problems.scenes.labels import parse_label, parse_settings

    extra = parse_settings(settings or [])
    for label in labels:
        model, given = parse_label(label.removeprefix(PREFIX))
        chosen = {"rigid": False, **given, **extra}
        strange = sorted(chosen.keys() - {"rigid"})
        if strange or not isinstance(chosen["rigid"], bool):
            what = strange[0] if strange else f"rigid={chosen['rigid']}"
            raise ValueError(f"{label}: {what}: a model takes rigid=true or rigid=false alone")
        with shown(f"record {label}", terminal(err=True)) as tell:
            made = record_mujoco(model, until, rigid=chosen["rigid"], progress=tell)
        path = folder / f"{made.scene}.h5"
        write_new(path, made, None if overwrite else kept_recording(path))
        say(f"{path}: {len(made.qps)} QPs, digest {made.digest[:12]}…")
        found = recorded_answers(made)
        if found is not None:
            say(f"MuJoCo's own forces: {found.sentence()}")
