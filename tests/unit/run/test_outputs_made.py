from __future__ import annotations

from pathlib import Path

import pytest

from arfx.errors import ConfigError
from arfx.run.outputs_made import NAME, OutputsMade
from arfx.run.place import place


def test_an_output_counts_as_it_was_made(tmp_path: Path) -> None:
    out = tmp_path / "a.mp4"
    out.write_bytes(b"1")
    OutputsMade(tmp_path).note(out, "key", 2.5, 30)
    made = OutputsMade(tmp_path).of(out)
    assert made is not None and (made.key, made.seconds, made.frames) == (
        "key",
        2.5,
        30,
    )
    assert (
        OutputsMade(tmp_path).files() == {out}
        and OutputsMade(tmp_path).of(tmp_path / "b.mp4") is None
    )
    out.write_bytes(b"22")
    assert OutputsMade(tmp_path).of(out) is None and not OutputsMade(tmp_path).files()
    OutputsMade(tmp_path).note(out, "later", 1.0, 30)
    made = OutputsMade(tmp_path).of(out)
    assert made is not None and made.key == "later", "the last line counts"


def test_images_count_together(tmp_path: Path) -> None:
    out = tmp_path / "a" / "%04d.png"
    out.parent.mkdir()
    assert place(out) == tmp_path / "a"
    for k in range(3):
        (out.parent / (out.name % k)).write_bytes(b"1")
    OutputsMade(tmp_path).note(out, "key", 1.0, 3)
    assert OutputsMade(tmp_path).of(out) is not None
    (out.parent / "0001.png").unlink()
    assert OutputsMade(tmp_path).of(out) is None


def test_damaged_lines_lose_themselves_alone(tmp_path: Path) -> None:
    out = tmp_path / "a.mp4"
    out.write_bytes(b"1")
    endless = b'{"output": "c.mp4", "key": "k", "files": "f", "seconds": 1, "frames": Infinity}'
    (tmp_path / NAME).write_bytes(
        b'{"output": 3}\n[]\n'
        + endless
        + b'\n\xff\n{"output": "b.mp4", "key": "k", "fi'
    )
    OutputsMade(tmp_path).note(out, "key", 1.0, 1)
    assert OutputsMade(tmp_path).files() == {out}


def test_a_link_is_refused(tmp_path: Path) -> None:
    """Nothing is written to, or read from, a file elsewhere."""
    other = tmp_path / "other"
    other.write_bytes(b"kept")
    (tmp_path / NAME).symlink_to(other)
    out = tmp_path / "a.mp4"
    out.write_bytes(b"1")
    with pytest.raises(ConfigError, match="is a link"):
        OutputsMade(tmp_path).note(out, "key", 1.0, 1)
    with pytest.raises(ConfigError, match="is a link"):
        OutputsMade(tmp_path).files()
    assert other.read_bytes() == b"kept"
