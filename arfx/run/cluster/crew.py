"""Who is there to work: the workers of a cluster as they come and go, and which of them may
get chunks.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from arfx.errors import RenderError
from arfx.run.cluster import remote

LOOK_S = 1.0  # between two looks at who is there
_START_S = 60.0  # for the first worker to answer
SILENT_S = 5.0  # a scheduler that says nothing for so long is gone
_ANSWER_S = 5.0  # for an answer that is there to be brought


@dataclass
class Member:
    """A worker. slots : chunks at once;  reads_on : number of the chunk after its last one
    asked : its answer, awaited; None = it has come;  refused : why it gets no work, "" = it may
    """

    slots: int
    asked: Any
    name: str = ""
    host: str = ""
    refused: str = ""
    reads_on: int = -1

    @property
    def ready(self) -> bool:
        return self.asked is None and not self.refused


class Crew:
    """The workers, by address.

    job : what they are to render, None = only versions are compared;  here : this process's
    (`environment`)
    notice : is told of workers that get no work"""

    def __init__(
        self,
        client: Any,
        here: Mapping[str, str],
        job: remote.JobReference | None,
        notice: Callable[[str], None],
    ) -> None:
        self._client, self._here, self._job, self._notice = client, here, job, notice
        self.members: dict[str, Member] = {}
        self._looked, self._began = -LOOK_S, time.monotonic()

    def look(self) -> dict[str, Member]:
        """Who has gone since the last look; who has come is asked. Raises RenderError where
        the scheduler is gone.
        """
        self._hear()
        if time.monotonic() - self._looked < LOOK_S:
            return {}
        threads = scheduler_says(
            self._client, lambda: self._client.nthreads(callback_timeout=SILENT_S)
        )
        self._looked = time.monotonic()
        gone = {
            address: self.members.pop(address)
            for address in [*self.members]
            if address not in threads
        }
        for address, slots in threads.items():
            if address not in self.members:
                asked = submit(self._client, address, remote.examine, self._here, self._job)
                self.members[address] = Member(slots, asked, address)
        return gone

    def _hear(self) -> None:
        """Take the answers that have come."""
        for address, member in self.members.items():
            if member.asked is None or not member.asked.done():
                continue
            answer, member.asked = member.asked, None
            try:
                said = answer.result(timeout=_ANSWER_S)
                member.name, member.host, member.refused = (
                    said["name"],
                    said["host"],
                    said["refused"],
                )
            except (
                Exception
            ) as e:  # arfx is not there, or is another, or the worker died over it
                member.refused = f"it does not answer as arfx does: {type(e).__name__}: {e}"
            if member.refused:
                self._notice(
                    f"worker {member.name} ({member.host or address}) gets no work:"
                    f" {member.refused}"
                )

    def refusal(self) -> str:
        """Why every worker that there is has been refused; "" where that is not so."""
        if not all(m.refused for m in self.members.values()):
            return ""
        return "; ".join(
            dict.fromkeys(f"{m.name}: {m.refused}" for m in self.members.values())
        )

    def check(self) -> None:
        """Raises RenderError where every worker that there is has been refused."""
        if why := self.refusal():
            raise RenderError(
                f"no worker may render: {why}",
                "the same arfx, Python and libraries on all machines; --map-path HERE=THERE"
                " where paths are others",
            )

    def anyone(self, tick: Callable[[], object] = lambda: None) -> bool:
        """Whether one may work.

        Waits for the answers of those that are there; tick() meanwhile, often
        """
        while True:
            self.look()
            ready, asked = (
                any(m.ready for m in self.members.values()),
                any(m.asked is not None for m in self.members.values()),
            )
            if ready or not asked or time.monotonic() - self._began > _START_S:
                return ready
            tick()
            time.sleep(0.05)

    def compared(self) -> Sequence[Member]:
        """Wait until one may work, or all are refused. Raises RenderError then."""
        self.anyone()
        self.check()
        return [m for m in self.members.values() if not m.refused]


class SchedulerLostError(RenderError):
    """Nothing that is said to the scheduler arrives."""


def submit(
    client: Any,
    address: str,
    function: Callable[..., Any],
    *arguments: Any,
    key: str | None = None,
) -> Any:
    """The future of a call on this very worker."""
    return client.submit(
        function,
        *arguments,
        key=key,
        workers=[address],
        allow_other_workers=False,
        pure=False,
        retries=0,
    )


def scheduler_says(client: Any, ask: Callable[[], Any]) -> Any:
    """What the scheduler answers. Raises SchedulerLostError where it is gone."""
    try:
        if client.status == "running":
            return ask()
    except (OSError, TimeoutError):  # distributed's errors of connections are both
        pass
    raise SchedulerLostError(
        f"the connection to the scheduler at {client.scheduler.address} is lost",
        "what is done is kept; --resume goes on, with the same cluster or another",
    )
