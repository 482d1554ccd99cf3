"""The workers of a cluster as they come and go, and which of them may work."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from arfx.errors import RenderError
from arfx.run.cluster import remote

LOOK_S = 1.0  # between two looks at who is there
SILENT_S = 5.0  # a scheduler that says nothing for so long is gone


@dataclass
class Member:
    """A worker. slots : tasks at once;  answer : the future of `remote.examine`

    refused : why it gets no work, "" = it may, None = it has not answered"""

    slots: int
    answer: Any
    refused: str | None = None


class Crew:
    """The workers, by address.

    job : what they are to do, None = only versions are compared;  here : this process's
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
        self._looked = -LOOK_S

    def look(self) -> None:
        """Who has come is asked, what was answered is heard. Raises RenderError where the
        scheduler is gone.
        """
        for address, member in self.members.items():
            if member.refused is None and member.answer.done():
                self._hear(address, member)
        check_connection(self._client)
        if time.monotonic() - self._looked < LOOK_S:
            return
        try:
            threads = self._client.nthreads(callback_timeout=SILENT_S)
        except (
            OSError,
            TimeoutError,
        ):  # distributed's errors of connections are both
            raise lost(self._client) from None
        self._looked = time.monotonic()
        self.members = {a: m for a, m in self.members.items() if a in threads}
        for address in threads.keys() - self.members.keys():
            asked = self._client.submit(
                remote.examine, self._here, self._job, workers=[address], pure=False
            )
            self.members[address] = Member(threads[address], asked)

    def _hear(self, address: str, member: Member) -> None:
        name = address
        try:
            name, member.refused = member.answer.result(timeout=SILENT_S)
        except (
            Exception
        ) as e:  # arfx is not there, or is another, or the worker died over it
            member.refused = (
                f"it does not answer as arfx does: {type(e).__name__}: {e}"
            )
        if member.refused:
            self._notice(f"worker {name} gets no work: {member.refused}")
            member.refused = f"{name}: {member.refused}"

    @property
    def slots(self) -> int:
        """Tasks at once, of the workers that may work."""
        return sum(m.slots for m in self.members.values() if m.refused == "")

    def refusal(self) -> str:
        """Why every worker that there is has been refused; "" where that is not so."""
        reasons = [m.refused for m in self.members.values()]
        return "; ".join(dict.fromkeys(filter(None, reasons))) if all(reasons) else ""

    def gathered(self, tick: Callable[[], object] = lambda: None) -> None:
        """Wait until all workers that are there have answered."""
        self.look()
        while any(m.refused is None for m in self.members.values()):
            tick()
            time.sleep(0.05)
            self.look()

    def check(self) -> None:
        """Raises RenderError where every worker that there is has been refused."""
        if why := self.refusal():
            raise RenderError(
                f"no worker may render: {why}",
                "the same arfx, Python and libraries on all machines; --map-path HERE=THERE"
                " where paths are others",
            )


def lost(client: Any) -> RenderError:
    return RenderError(
        f"the connection to the scheduler at {client.scheduler.address} is lost",
        "what is done is kept; --resume goes on, with the same cluster or another",
    )


def check_connection(client: Any) -> None:
    """Raises RenderError where the scheduler is gone."""
    if client.status != "running":
        raise lost(client)
