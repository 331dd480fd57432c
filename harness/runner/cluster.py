"""Tasks carried out by a Dask cluster: one that is there, by its address, or one of this machine.

Dask knows what runs where and starts again what was lost; how a cluster comes to be, on SLURM or
Kubernetes, is its deployments' business. A worker needs this package and nothing that is shared.
Timed tasks go to workers that offer the resource ``MACHINE``, one for each machine, and hold the
machine's lock besides.
"""

from __future__ import annotations

import contextlib
import pickle
import queue
import time
from collections import Counter
from typing import Any, Self
from urllib.parse import urlsplit

from harness.core.protocol.errors import InputError
from harness.runner import carried_files
from harness.runner.limits import Limits
from harness.runner.task import Answer, Task
from harness.suite.plan import Plan

RESOURCE = "MACHINE"
TRIES = 4
"""Of a task that Dask gave up, after it had been started again itself."""
_WAIT = 1.0
_CONNECT = 15.0
_PATIENCE = 60.0


def connect(scheduler: str | None, workers: int) -> Any:
    """A client of the cluster at ``scheduler``, or of so many worker processes here.

    Raises:
        InputError: Dask is not installed, or nobody answers at the address.
    """
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        raise InputError(
            "--executor dask needs Dask: pip install 'bsdf-sampling-harness[dask]'"
        ) from None
    if scheduler is None:
        cluster = LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            dashboard_address=None,
            resources={RESOURCE: 1},
            memory_limit=0,  # ours is counted where the work is
            silence_logs=50,
        )
        return Client(cluster)
    try:
        client = Client(scheduler, timeout=_CONNECT)
    except (OSError, TimeoutError, ValueError) as error:
        said = str(error).partition("\n")[0] or type(error).__name__
        raise InputError(f"--scheduler {scheduler}: no scheduler answers there: {said}") from None
    if not client.scheduler_info(n_workers=-1)["workers"]:
        client.close()
        raise InputError(f"--scheduler {scheduler}: has no workers; start some first")
    return client


class Cluster:
    """See :class:`harness.runner.executor.Executor`; ``client`` is closed with it."""

    isolated = True

    def __init__(self, client: Any, device: str, limits: Limits):
        self.client, self.device, self.limits = client, device, limits
        self.plugin = ""
        self.answers: queue.Queue[tuple[int, Any]] = queue.Queue()
        self.given: dict[int, tuple[Task, Any, int]] = {}
        self.machines: dict[str, dict[str, Any]] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        from harness.runner import on_cluster

        try:
            self.client.cancel([future for _, future, _ in self.given.values()])
            if self.plugin:
                self.client.run(on_cluster.rest, on_error="ignore")
                self.client.unregister_worker_plugin(self.plugin)
        finally:
            cluster = self.client.cluster
            self.client.close()
            if cluster is not None:
                cluster.close()

    def machine(self) -> dict[str, Any]:
        """The identity of the machines that most workers run on: times are taken there."""
        self._look()
        if not self.machines:
            raise InputError("--executor dask: no worker says what machine it runs on")
        counted = Counter(repr(m["identity"]) for m in self.machines.values())
        ((most, _),) = counted.most_common(1)
        return next(m["identity"] for m in self.machines.values() if repr(m["identity"]) == most)

    def carry(self, plan: Plan) -> None:
        """Hand out the files that a plan names, to the workers that there are and will be."""
        from harness.runner import on_cluster

        files = on_cluster.Files(carried_files.of(plan))
        self.client.register_plugin(files)
        self.plugin = files.name

    @property
    def slots(self) -> int:
        """Threads of all workers."""
        workers = self.client.scheduler_info(n_workers=-1)["workers"].values()
        return max(1, sum(worker["nthreads"] for worker in workers))

    @property
    def timed_slots(self) -> int:
        """Machines that can time."""
        workers = self.client.scheduler_info(n_workers=-1)["workers"]
        self._look()
        able = [a for a, w in workers.items() if w["resources"].get(RESOURCE)]
        return max(1, len({self.machines[a]["host"] for a in able if a in self.machines}))

    def submit(self, number: int, task: Task) -> None:
        """See :class:`harness.runner.executor.Executor`."""
        self._submit(number, task, 1)

    def wait(self) -> list[tuple[int, Answer]]:
        """See :class:`harness.runner.executor.Executor`."""
        if not self.given:
            return []
        try:
            number, future = self.answers.get(timeout=_WAIT)
        except queue.Empty:
            self._refill()
            return []
        task, known, tries = self.given.pop(number)
        if future is not known:  # of an earlier try
            self.given[number] = task, known, tries
            return []
        if future.status == "finished":
            return [(number, self._checked(task, pickle.loads(future.result())))]
        error = future.exception() if future.status == "error" else None
        if tries < TRIES and (error is None or type(error).__name__ == "KilledWorker"):
            self._submit(number, task, tries + 1)
            return []
        kind = type(error).__name__ if error is not None else "cancelled"
        return [(number, Answer(died=f"Dask gave it up: {kind}: {error}"))]

    # --- inside --------------------------------------------------------------------------------

    def _submit(self, number: int, task: Task, tries: int) -> None:
        from harness.runner import on_cluster

        where: dict[str, Any] = {"resources": {RESOURCE: 1}} if task.alone else {}
        wanted = task.first.identity.get("machine") if task.trials else None
        if wanted is not None:
            where["workers"] = self._like(wanted)
        data = pickle.dumps(task, protocol=5)
        future = self.client.submit(
            on_cluster.carried_out,
            *(data, self.plugin, self.device, self.limits),
            pure=False,
            priority=-number,
            **where,
        )
        self.given[number] = task, future, tries
        future.add_done_callback(lambda done: self.answers.put((number, done)))

    def _refill(self) -> None:
        """Start workers of this machine's own cluster anew that Dask has given up."""
        if (cluster := self.client.cluster) is not None:
            cluster.scale(len(cluster.worker_spec))

    def _like(self, identity: dict[str, Any]) -> list[str]:
        """Hosts that are machines of this identity: a worker that is started again has another
        address there. They may all be about to be started again: they are waited for."""
        end = time.monotonic() + _PATIENCE
        while True:
            self._look()
            like = [a for a, m in self.machines.items() if m["identity"] == identity]
            if like or time.monotonic() > end:
                break
            self._refill()
            time.sleep(_WAIT)
        found = sorted({str(urlsplit(address).hostname) for address in like})
        if not found:
            raise InputError(
                f"no worker runs on the machine that the trials are of ({identity.get('cpu')},"
                f" {identity.get('cores')} cores)"
            )
        return found

    def _look(self) -> None:
        """Ask workers that came since what their machines are."""
        from harness.runner import on_cluster

        there = set(self.client.scheduler_info(n_workers=-1)["workers"])
        self.machines = {a: m for a, m in self.machines.items() if a in there}
        if new := there - set(self.machines):
            # A worker that dies meanwhile is asked after again.
            with contextlib.suppress(OSError):
                self.machines |= self.client.run(
                    on_cluster.machine, self.device, workers=list(new), on_error="ignore"
                )

    @staticmethod
    def _checked(task: Task, answer: Answer) -> Answer:
        """The answer, unless it is of another machine than the trial's times are to be of."""
        wanted, got = task.first.identity.get("machine"), answer.environment.get("machine", {})
        if wanted and got and any(got.get(key) != value for key, value in wanted.items()):
            return Answer(died=f"carried out on another machine: {got.get('cpu')}")
        return answer
