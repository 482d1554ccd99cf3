"""The errors a user can meet: one message each (what, where, what would be right) and an
exit code.
"""

from __future__ import annotations

LONGEST = (
    4000  # characters of a message; what is wrong may be megabytes of somebody's file
)


def cut(text: str) -> str:
    """The text, or its ends where it is too long."""
    if len(text) <= LONGEST:
        return text
    return f"{text[: LONGEST // 2]} … ({len(text)} characters) … {text[-200:]}"


class ArfxError(Exception):
    """A failure with one clear message.
    message : what is wrong and where (file, frame, key)
    hint : what would be right; printed on a line of its own, may be empty
    exit_code : the process's exit status (documented in CLI help)"""

    exit_code = 5

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(cut(message))
        self.message = cut(message)
        self.hint = cut(hint)

    def __str__(self) -> str:
        return f"{self.message}\nhelp: {self.hint}" if self.hint else self.message

    def __reduce__(self) -> tuple[type[ArfxError], tuple[str, str]]:
        return type(self), (self.message, self.hint)


class ConfigError(ArfxError, ValueError):
    """Usage or configuration is wrong (exit 2). A ValueError: a model's validators may raise it."""

    exit_code = 2


class InputError(ArfxError):
    """An input cannot be read or makes no sense (exit 3)."""

    exit_code = 3


class NothingToDoError(ArfxError):
    """The inputs are fine, but hold nothing to work on: no marker, no board (exit 4)."""

    exit_code = 4


class RenderError(ArfxError):
    """Rendering or writing failed (exit 5)."""

    exit_code = 5


class JobInterruptedError(ArfxError):
    """The user stopped the job; it can be resumed (exit 130)."""

    exit_code = 130


def explained(e: BaseException) -> tuple[int, str]:
    """Exit code and message of whatever ended a piece of work."""
    if isinstance(e, ArfxError):
        return e.exit_code, str(e)
    if isinstance(e, OSError):
        return 5, f"{e.strerror or e}{f': {e.filename}' if e.filename else ''}"
    if isinstance(e, RuntimeError) and str(e).startswith("Symlink loop"):  # pathlib's
        return (
            2,
            (
                f"{str(e).removeprefix('Symlink loop from ')} is a link to itself\nhelp:"
                " remove it, or name another place"
            ),
        )
    if isinstance(e, MemoryError):
        what = (
            f"there is not enough memory: {e}"
            if str(e)
            else "there is not enough memory"
        )
        return (
            5,
            f"{what}\nhelp: close programs, raise the limit (ulimit -v), or --workers 1",
        )
    # a fault of arfx itself: one message all the same
    return (
        5,
        (
            f"arfx failed: {type(e).__name__}: {cut(str(e))}\nhelp: ARFX_DEBUG=1 shows"
            " where; please report it"
        ),
    )


def counted(number: int, things: str) -> str:
    """ "1 frame", "2 frames"."""
    return f"{number} {things[:-1] if number == 1 else things}"


def on_one_line(message: str) -> str:
    """A message and its help, for a list of several."""
    return " ".join(
        filter(None, map(str.strip, message.replace("\nhelp: ", "; ").splitlines()))
    )
