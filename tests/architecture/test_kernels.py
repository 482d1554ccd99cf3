"""Compiled functions take few arguments: arrays that belong together come as a named tuple."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).parents[2] / "arfx"
MOST = 10
COMPILED = ("kernel", "njit", "line_kernel")


def too_many(source: str) -> list[str]:
    """Compiled functions of more than MOST parameters."""
    functions = [
        n for n in ast.walk(ast.parse(source)) if isinstance(n, ast.FunctionDef)
    ]
    compiled = [
        f
        for f in functions
        if any(ast.unparse(d).startswith(COMPILED) for d in f.decorator_list)
    ]
    return [
        f.name for f in compiled if len(f.args.args) + len(f.args.kwonlyargs) > MOST
    ]


def test_kernels_take_at_most_ten_arguments() -> None:
    assert not {
        path: found
        for path in ROOT.rglob("*.py")
        if (found := too_many(path.read_text()))
    }


def test_the_rule_sees_a_function_of_eleven() -> None:
    eleven = ", ".join("abcdefghijk")
    assert too_many(
        f"@kernel()\ndef f({eleven}): ...\n@line_kernel()\ndef g({eleven}): ..."
    ) == ["f", "g"]
    assert too_many("@kernel()\ndef f(a, b): ...\ndef g(" + eleven + "): ...") == []
