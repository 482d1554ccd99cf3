"""Messages as they are shown in lists."""

from __future__ import annotations

from arfx.errors import ConfigError, explained, on_one_line


def test_a_message_on_one_line_keeps_the_names_in_it() -> None:
    assert (
        on_one_line(str(ConfigError("two  spaces.mp4 exists", "name another")))
        == "two  spaces.mp4 exists; name another"
    )
    assert (
        on_one_line("bad key\n  --> job.toml:3\nhelp: see `arfx stages`")
        == "bad key --> job.toml:3; see `arfx stages`"
    )


def test_what_lacks_memory_says_so() -> None:
    assert explained(MemoryError("Unable to allocate 4 GiB"))[1].startswith(
        "there is not enough memory: Unable to allocate"
    )
