"""Every document, heading and test that the tree cites is there."""

from __future__ import annotations

import re
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import pytest

from tests.architecture.test_wheel import project_files

ROOT = Path(__file__).parents[2]
TEXTS = (".py", ".md", ".toml", ".txt", ".in", "")
_DOCUMENT = re.compile(r"((?:[\w.-]+/)*[\w-]+\.md)(?!\w)(?:#([\w-]+))?")
_TEST = re.compile(r"(tests/[\w/]+\.py)::(\w+)")
_MADE = {
    "table.md",
    "hard/table.md",
    "calibrated/table.md",
    "looks/table.md",
}  # by a command


def texts() -> dict[str, str]:
    paths = [
        ROOT / name
        for name in project_files()
        if name != str(Path(__file__).relative_to(ROOT))
    ]
    return {
        str(p.relative_to(ROOT)): p.read_text(encoding="utf-8")
        for p in paths
        if p.suffix in TEXTS and p.is_file()
    }


@cache
def anchors(document: Path) -> set[str]:
    """Of its headings, as GitHub makes them."""
    found = re.findall(
        r"^#+ (.+)$", document.read_text(encoding="utf-8"), re.MULTILINE
    )
    return {
        re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in found
    }


def missing(text: str, documents: Iterable[str]) -> list[str]:
    """What a text cites and the tree has not.

    documents : paths of all; a citation may leave folders out
    """
    out = []
    for cited, anchor in _DOCUMENT.findall(text):
        found = [
            d for d in documents if f"/{d}".endswith(f"/{cited.removeprefix('../')}")
        ]
        if cited not in _MADE and not any(
            not anchor or anchor in anchors(ROOT / d) for d in found
        ):
            out.append(f"{cited}{'#' + anchor if anchor else ''}")
    return out + [
        f"{file}::{test}"
        for file, test in _TEST.findall(text)
        if not _has(ROOT / file, test)
    ]


def _has(file: Path, test: str) -> bool:
    return (
        file.is_file()
        and re.search(
            rf"^def {test}\(", file.read_text(encoding="utf-8"), re.MULTILINE
        )
        is not None
    )


def test_every_document_heading_and_test_that_is_cited_exists() -> None:
    found = texts()
    assert "README.md" in found and "arfx/errors.py" in found
    documents = [name for name in found if name.endswith(".md")]
    assert not (
        wrong := [
            f"{name}: {m}"
            for name, text in found.items()
            for m in missing(text, documents)
        ]
    ), "\n".join(wrong)


def test_papers_are_cited_by_their_authors() -> None:
    short = re.compile(r"\bS[1-4]\b")
    found = {
        name: text
        for name, text in texts().items()
        if name.startswith(("arfx/", "cli/", "docs/", "tests/", "README"))
    }
    assert not [name for name, text in found.items() if short.search(text)]


@pytest.mark.parametrize(
    ("text", "sound"),
    [
        ("see docs/methods/light.md#update", True),
        ("see docs/methods/light.md#upddate", False),
        ("see NOTES.md", False),
        ("`tests/unit/papers/test_s2_dof.py::test_numbers_of_the_paper`", True),
        ("`tests/unit/core/test_lens.py::test_numbers`", False),
    ],
)
def test_what_is_cited_wrongly_is_found(text: str, sound: bool) -> None:
    assert (not missing(text, ["docs/methods/light.md"])) == sound
