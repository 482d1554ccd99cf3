"""Files of the job folder that are read in parts."""

from __future__ import annotations

from pathlib import Path

import pytest

from arfx.run.folder import Lines


@pytest.mark.parametrize("header", [0, 1])
def test_a_slice_of_lines_is_that_of_all_of_them_and_nothing_else_is_read(
    header: int, tmp_path: Path
) -> None:
    path = tmp_path / "lines"
    written = [f"{k} ä".rjust(k % 7) for k in range(40)]
    path.write_text("".join(f"{line}\n" for line in written), encoding="utf-8")
    lines, wanted = Lines(path, str, header), written[header:]
    for part in (
        slice(None),
        slice(3, 5),
        slice(30, 99),
        slice(0, 1),
        slice(7, 7),
        slice(50, 60),
        slice(38, None),
    ):
        assert lines[part] == wanted[part]
    parsed: list[str] = []
    Lines(path, parsed.append, header)[10:12]
    assert parsed == wanted[10:12]
    data = bytearray(path.read_bytes())
    data[: len("0 ä\n1 ä\n".encode())] = bytes([0xFF]) * len(
        "0 ä\n1 ä\n".encode()
    )  # what is not asked for may be anything
    path.write_bytes(data)
    assert lines[20:23] == wanted[20:23]
    path.write_text("", encoding="utf-8")
    assert Lines(path, str)[:] == []
