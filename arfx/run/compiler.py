"""Kernels compiled ahead, in processes of their own (kernels.py): numba, made to do only
what the kept code needs.

numba by itself makes machine code, two more entry points and a cache file of every function
that a kernel calls, although that function is linked into the kernel once more, and works
out ten times over what the same operation on the same types gives. Without that kernels
compile in half the time, and give the same bits. This is done here alone, where compiled
code is never called."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

TRIED = (  # version of numba whose inner parts are these; another one compiles in its own way
    "0.68."
)


def _inferred_once(infer: Callable[..., Any]) -> Callable[..., Any]:
    """The types of a call, found once for the same arguments under the same options."""
    from numba.core.targetconfig import ConfigStack

    known: dict[Any, Any] = {}
    named: dict[
        int, tuple[Any, str]
    ] = {}  # the options in force, kept: another's must not get the number of one that is gone

    def infer_once(self: Any, context: Any, arguments: Any, named_arguments: Any) -> Any:
        options = ConfigStack.top_or_none()
        _, text = named.get(id(options)) or named.setdefault(
            id(options), (options, str(options))
        )
        key = self, tuple(arguments), tuple(named_arguments.items()), text
        if key not in known:
            known[key] = infer(self, context, arguments, named_arguments)
        return known[key]

    return infer_once


@cache
def compile_kernels_only() -> None:
    """Change numba in this process: what is compiled from now on can be kept, not called."""
    import numba

    if not numba.__version__.startswith(TRIED):
        return
    from numba import _dynfunc  # type: ignore[attr-defined]
    from numba.core import transforms
    from numba.core.caching import NullCache
    from numba.core.codegen import JITCodeLibrary
    from numba.core.cpu import CPUContext
    from numba.core.dispatcher import Dispatcher, _FunctionCompiler  # type: ignore[attr-defined]
    from numba.core.postproc import PostProcessor, VariableLifetime
    from numba.core.sigutils import normalize_signature
    from numba.core.types.functions import BaseFunction

    depth = 0  # of functions being compiled: 1 = a kernel, more = what it calls

    class Part(JITCodeLibrary):
        """Of a function that a kernel calls: only linked into the kernel, and optimised there."""

        def _optimize_final_module(self) -> None:
            pass

        def _finalize_final_module(self) -> None:
            self._finalize_dynamic_globals()
            self._verify_declare_only_symbols()
            self._finalized = True

    compile_function, get_executable = Dispatcher.compile, CPUContext.get_executable
    compile_core = _FunctionCompiler._compile_core

    def compile_for_cache(self: Any, types: Any) -> Any:
        if not depth:
            self.overloads.pop(
                tuple(normalize_signature(types)[0]), None
            )  # it may be there as a part of another kernel
            return compile_function(self, types)
        cache, self._cache = self._cache, NullCache()
        try:
            return compile_function(self, types)
        finally:
            self._cache = cache

    def compile_deeper(self: Any, *types: Any) -> Any:
        nonlocal depth
        depth += 1
        try:
            return compile_core(self, *types)
        finally:
            depth -= 1

    def with_one_entry(self: Any, flags: Any) -> Any:
        flags.no_cfunc_wrapper = True
        flags.no_cpython_wrapper = depth > 1
        return flags

    def executable_of_kernels(
        self: Any, library: Any, function: Any, environment: Any
    ) -> Any:
        if depth == 1:
            return get_executable(self, library, function, environment)
        library.__class__ = Part
        return _dynfunc.make_function(
            function.lookup_module(), function.qualname, "", 1, environment, (library,)
        )

    def postprocess(
        self: Any, emit_dels: bool = False, extend_lifetimes: bool = False
    ) -> None:
        # after every pass; without which variables a block is entered with, which
        # generators and Python objects alone need
        function = self.func_ir
        function.blocks = transforms.canonicalize_cfg(function.blocks)
        function.variable_lifetime, function.generator_info = (
            VariableLifetime(function.blocks),
            None,
        )
        if emit_dels:
            self._insert_var_dels(extend_lifetimes=extend_lifetimes)

    changes: list[tuple[Any, str, Any]] = [
        (Dispatcher, "compile", compile_for_cache),
        (_FunctionCompiler, "_compile_core", compile_deeper),
        (_FunctionCompiler, "_customize_flags", with_one_entry),
        (CPUContext, "get_executable", executable_of_kernels),
        (BaseFunction, "get_call_type", _inferred_once(BaseFunction.get_call_type)),
        (PostProcessor, "run", postprocess),
    ]
    for of, name, function in changes:
        setattr(of, name, function)
