"""One process at a time in a folder: the lock ends with the process, however it ends, and
shows others who has it.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import shlex
import socket
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from arfx.core.guard import atomic_write
from arfx.core.opener import printable, why
from arfx.errors import ConfigError, RenderError

if TYPE_CHECKING:
    from filelock import BaseFileLock

LOCK, MARKER, HOLDER = "arfx.lock", "arfx.lock.marker", "arfx.lock.json"
# What disks say that know no locks; there a marker file names the process, and counts as
# long as that lives
_NO_LOCKS = (errno.ENOSYS, errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP)


@contextlib.contextmanager
def locked(folder: Path, option: str, temporary: bool = False) -> Iterator[None]:
    """Lock `folder`, which is made if need be. One that was made here, or is `temporary`,
    is removed in the end if it is empty.

    option : what names another folder, for the message
    Raises ConfigError at once if another process holds it, RenderError where it cannot be
    made or written to."""
    created = not folder.is_dir()
    lock = _acquire(folder, option)
    try:
        with (
            contextlib.suppress(OSError),
            atomic_write(folder / HOLDER) as part,
        ):  # without it, on a full disk, others cannot see who
            command = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])
            me = {
                "pid": os.getpid(),
                "host": socket.gethostname(),
                "since": time.strftime("%Y-%m-%d %H:%M:%S"),
                "command": printable(command),
            }
            part.write_text(json.dumps(me), encoding="utf-8")
        yield
    finally:
        _release(lock, folder)
        if created or temporary:
            with contextlib.suppress(OSError):
                folder.rmdir()


def _acquire(folder: Path, option: str) -> BaseFileLock:
    from filelock import FileLock, SoftFileLock, Timeout

    lock: BaseFileLock = FileLock(
        folder / LOCK, blocking=False, thread_local=False, fallback_to_soft=False
    )
    for _ in range(100):
        try:
            folder.mkdir(parents=True, exist_ok=True)
            lock.acquire()
            return lock
        except Timeout:
            raise ConfigError(
                f"{folder} is in use{_holder(folder)}",
                f"wait until that is done, or name another with {option}",
            ) from None
        except (FileNotFoundError, FileExistsError) as e:
            # most likely its last holder is just removing it: try again
            failure = why(e)
        except OSError as e:
            failure = why(e)
            if e.errno not in _NO_LOCKS or isinstance(lock, SoftFileLock):
                break
            lock = SoftFileLock(folder / MARKER, blocking=False, thread_local=False)
    raise RenderError(
        f"cannot write into {folder.parent}: {failure}",
        f"name another place with {option}",
    )


def _release(lock: BaseFileLock, folder: Path) -> None:
    """The files go first: whoever opened the lock before sees that it has no name any more,
    and tries again.
    """
    files = (folder / HOLDER, folder / LOCK)
    for path in files:
        with contextlib.suppress(OSError):  # Windows refuses while it is open
            path.unlink(missing_ok=True)
    with contextlib.suppress(OSError):
        lock.release()
    if os.name == "nt":
        with contextlib.suppress(OSError):
            files[1].unlink(missing_ok=True)


def _holder(folder: Path) -> str:
    try:
        holder = json.loads((folder / HOLDER).read_text(encoding="utf-8"))
        command = (
            holder["command"]
            if len(holder["command"]) <= 120
            else f"{holder['command'][:119]}…"
        )
        return (
            f" by process {holder['pid']} on {holder['host']}, since {holder['since']}:"
            f" {command}"
        )
    except (OSError, ValueError, KeyError, TypeError):
        return " by another process"
