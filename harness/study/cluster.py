"""A replay spread over the workers of a Dask cluster, local or elsewhere.

A *job* is what must stay on one machine:

- timed: a recording at an accuracy, with all solvers in all arms, so that every ratio of times is
  formed on one machine, and passes go round there;
- for accuracy alone: a recording at an accuracy with one solver.  One pass; its times compare with
  nobody's.

1. A worker has one thread and does one job at a time, by `harness.study.replay`, in a temporary
   folder. It hands back the shards; the parent alone writes into the results folder.
2. A worker that is lost, or retired, loses its job, which goes to another one.  A job that has cost
   `MOST_LOST` workers is given up, by name.
3. Every worker must run the code of the parent: versions are compared before a job begins.
4. Jobs of which every shard is there already, from whatever machine, are not sent.  One of which
   some are is done again as a whole.

Workers of a cluster of one's own are started by `dask worker ADDRESS --nthreads 1 --no-nanny` where
glambda is installed.
"""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import pandas as pd

from harness.judging.facts import setting_names
from harness.machine.machine import problems_version
from harness.passes.limits import MEMORY_LIMIT, TIME_LIMIT
from harness.processes.introduction import about, solver_version
from harness.processes.process import server
from harness.progress import Progress
from harness.recordings.recording import Recording, read_recording
from harness.results.store import ShardKey, Store, read_results
from harness.study.replay import is_done, replay

if TYPE_CHECKING:
    from distributed import Client

MOST_LOST = 3
"""Workers that a job may cost before it is given up."""
PATIENCE = 30.0
"""[s] in which a cluster must answer, and have a worker."""


class Job(NamedTuple):
    """What one worker does: a recording (its place in the list) at a setting by some solvers."""

    recording: int
    setting: str
    solvers: tuple[str, ...]


class ClusterError(ValueError):
    """A cluster that cannot be reached or does not do its work, with the remedy."""


@contextmanager
def connected(cluster: str | int) -> Iterator[Client]:
    """A client of the cluster at an address, or of that many workers started here and now.

    Raises ImportError without Dask, and ClusterError where nobody answers.
    """
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError:
        raise ImportError(
            "spreading a study over workers needs Dask: pip install 'glambda[cluster]'"
        ) from None
    settings = {
        "distributed.scheduler.allowed-failures": MOST_LOST,
        # a worker's passes run in processes of their own
        "distributed.worker.daemon": False,
        "distributed.worker.profile.enabled": False,
        # recordings go to the workers with the tasks
        "distributed.admin.large-graph-warning-threshold": "8 GiB",
    }
    with dask.config.set(settings):
        if isinstance(cluster, int):
            with (
                LocalCluster(
                    n_workers=cluster, threads_per_worker=1, processes=True, host="127.0.0.1",
                    dashboard_address="127.0.0.1:0", memory_limit=0, silence_logs=logging.CRITICAL,
                ) as local,
                Client(local) as client,
            ):  # fmt: skip
                yield client
            return
        try:
            client = Client(cluster, timeout=PATIENCE)
        except (OSError, ValueError) as error:
            raise ClusterError(
                f"--cluster {cluster}: no scheduler answers there ({error}); start one with "
                "'dask scheduler', or use --workers"
            ) from None
        with client:
            try:
                client.wait_for_workers(1, timeout=PATIENCE)
            except TimeoutError:
                raise ClusterError(
                    f"--cluster {cluster}: the scheduler has no workers; start some with "
                    f"'dask worker {cluster} --nthreads 1'"
                ) from None
            yield client


@contextmanager
def replayer(cluster: str | int | None, *, timed: bool = True) -> Iterator[Callable[..., Any]]:
    """`replay`, or `replay_on` a cluster, given as `connected` takes it; None: `replay`."""
    if cluster is None:
        yield partial(replay, timed=timed)
        return
    with connected(cluster) as client:
        yield partial(replay_on, client, timed=timed)


def replay_on(
    client: Client,
    recordings: Iterable[Recording | str | Path],
    solvers: Sequence[str],
    settings: Sequence[str],
    arms: Sequence[str],
    *,
    results: str | Path | None = None,
    timed: bool = True,
    time_limit: float = TIME_LIMIT,
    memory_limit: float = MEMORY_LIMIT,
    progress: Progress | None = None,
    **options: Any,
) -> pd.DataFrame:
    """Replay on the workers of a cluster; return the rows of the results folder.

    timed : False for accuracy alone: smaller jobs of one pass, whose times compare with nothing
    time_limit, memory_limit, options : repeats, slow_pass, study, as for
        `harness.study.replay.replay`
    progress : called with the name of a job and the QPs solved, of all

    Raises what `replay` raises, and ClusterError where workers run other code, or a job has cost
    too many of them.  Jobs that were finished are stored.
    """
    from distributed import as_completed

    loaded = [r if isinstance(r, Recording) else read_recording(r) for r in recordings]
    settings = setting_names(settings)
    options |= {"time_limit": time_limit, "memory_limit": memory_limit}
    if not timed:
        options |= {"repeats": 1, "timed": False}
    with tempfile.TemporaryDirectory() if results is None else nullcontext(results) as folder:
        store = Store(folder)
        paths = [store.add_recording(recording) for recording in loaded]
        groups = [tuple(solvers)] if timed else [(name,) for name in solvers]
        jobs = [
            Job(place, setting, group)
            for place in range(len(loaded))
            for setting in settings
            for group in groups
        ]
        sizes = {job: len(loaded[job.recording].qps) * len(job.solvers) for job in jobs}
        done, total = 0, sum(sizes.values())
        # as results of tasks, and not scattered, so that what a lost worker held is made again
        contents = [client.submit(_as_it_is, path.read_bytes(), pure=False) for path in paths]
        versions = {
            "problems": problems_version(),
            **{name: solver_version(name) for name in solvers},
        }
        keys = {job: _keys(job, loaded, arms, versions, options) for job in jobs}
        store.refuse_mixture(key for job in jobs for key in keys[job])
        asked = {name: options[name] for name in ("repeats", "slow_pass") if name in options}
        futures = {}
        for job in jobs:
            if all(is_done(store.made_anywhere(key), **asked) for key in keys[job]):
                done += sizes[job]
                continue
            future = client.submit(
                do_job, contents[job.recording], job.setting, job.solvers, tuple(arms), versions,
                options, pure=False,
            )  # fmt: skip
            futures[future] = job
        for future in as_completed(list(futures)):
            job = futures[future]
            name = f"{loaded[job.recording].scene} {job.setting}"
            for shard, content in sorted(_result(future, name).items()):
                store.adopt(shard, content)
            future.release()
            done += sizes[job]
            if progress is not None:
                progress(name, done, total)
        return read_results(folder)


def _keys(
    job: Job,
    recordings: Sequence[Recording],
    arms: Sequence[str],
    versions: dict[str, str],
    options: dict[str, Any],
) -> list[ShardKey]:
    """Keys of the shards that a job makes, but for the machine."""
    recording = recordings[job.recording]
    return [
        ShardKey(
            scene=recording.scene,
            recording_digest=recording.digest,
            solver=solver,
            settings=job.setting,
            arm=arm,
            versions=versions[solver],
            machine="",
            time_limit=options["time_limit"],
            memory_limit=options["memory_limit"],
        )
        for solver in job.solvers
        for arm in arms
        if arm in about(solver).arms or about(solver).broken
    ]


def _result(future: Any, name: str) -> dict[str, bytes]:
    from distributed import KilledWorker

    try:
        found: dict[str, bytes] = future.result()
    except KilledWorker:
        raise ClusterError(
            f"{name}: the job has cost {MOST_LOST} workers and is given up; what was finished is "
            "kept: look at the workers' logs, then run the same command again"
        ) from None
    return found


def _as_it_is(content: bytes) -> bytes:
    return content


def do_job(
    content: bytes,
    setting: str,
    solvers: tuple[str, ...],
    arms: tuple[str, ...],
    versions: dict[str, str],
    options: dict[str, Any],
) -> dict[str, bytes]:
    """On a worker: replay a recording, given as the bytes of its file; return its shards by name.

    versions : of the parent's code

    Raises ClusterError where this worker's differ.
    """
    ours = {"problems": problems_version(), **{name: solver_version(name) for name in solvers}}
    for name, version in ours.items():
        if versions[name] != version:
            raise ClusterError(
                f"a worker has {name} {version!r}, the study {versions[name]!r}; install the same "
                "versions on all workers"
            )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.h5"
        path.write_bytes(content)
        results = Path(folder) / "results"
        replay(path, solvers, (setting,), arms, results=results, **options)
        server().close()  # a worker that is told to end must have nothing left to wait for
        return {shard.name: shard.read_bytes() for shard in (results / "solves").glob("*.parquet")}
