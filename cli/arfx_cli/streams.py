"""Standard streams that may be closed, full or without a reader: a job does not end because
nobody can read its messages.

What goes to a stream that is closed or that its reader has left is dropped. A result that
cannot be written to standard output for another reason, such as a full disk, is an error,
reported when the command has ended."""

from __future__ import annotations

import errno
import io
import os
import sys
from typing import Any

_GONE = (
    errno.EPIPE,
    errno.EBADF,
    errno.EIO,
)  # no reader; closed; a terminal that was hung up
_output: _Lenient | None = None


class _Lenient(io.FileIO):
    """A stream whose failures are kept, not raised."""

    failure: OSError | None = None

    def write(self, data: Any) -> int:
        try:
            return super().write(data) or 0
        except OSError as e:
            if e.errno not in _GONE:
                self.failure = e
            return memoryview(data).nbytes


def make_safe() -> None:
    """Put lenient streams in place of standard output and standard error."""
    global _output
    for number in range(
        3
        # a file opened later would get the number of one that is closed, and libraries'
        # messages with it
    ):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    _output = _Lenient(1, "wb", closefd=False)
    sys.stdout = _over(_output, sys.stdout, line_buffering=_output.isatty())
    sys.stderr = _over(
        _Lenient(2, "wb", closefd=False), sys.stderr, line_buffering=True
    )


def _over(raw: _Lenient, before: Any, line_buffering: bool) -> Any:
    """A text stream over `raw` in place of `before`.

    What the encoding lacks is written as a number.
    """
    if before is not None and before.isatty() and os.name == "nt":
        return before  # the console takes text, not bytes
    encoding = "utf-8" if before is None else before.encoding
    return io.TextIOWrapper(
        io.BufferedWriter(raw),
        encoding,
        "backslashreplace",
        line_buffering=line_buffering,
    )


def closing_code(code: int) -> int:
    """The exit code, with what became of the results: 5 where standard output did not take them."""
    sys.stdout.flush()
    failure = _output.failure if _output else None
    if failure is not None and not code:
        sys.stderr.write(
            f"error: standard output: {failure.strerror}\nhelp: what was to be printed is"
            " lost; files are written\n"
        )
        return 5
    return code
