"""Functions that only compiled code calls, compiled into their callers alone.

Numba optimises each function together with all that it calls, and makes machine code of it; a caller then takes in what
was optimised and does the same again, up to whatever Python calls. The core is a hundred functions, ten deep: that was
more than a quarter of the time of compiling it. Here a function stays in LLVM's language until one that Python calls
takes it in: all is optimised, and made into machine code, once. The machine code is the same.
"""

from __future__ import annotations

from typing import Any

from numba import _dynfunc  # type: ignore[attr-defined]  # an extension, without types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass
from numba.core.typed_passes import NativeLowering


class _LinkedLibrary(JITCodeLibrary):
    """Code that is only taken in by other code."""

    def __init__(self, codegen: Any, name: str) -> None:
        super().__init__(codegen, name)  # type: ignore[no-untyped-call]
        self.enable_object_caching()  # type: ignore[no-untyped-call]

    def _optimize_final_module(self) -> None:
        """Left to whatever takes it in."""

    def _finalize_final_module(self) -> None:
        """Without machine code."""
        self._finalize_dynamic_globals()  # type: ignore[no-untyped-call]
        self._finalized = True


@register_pass(mutates_CFG=True, analysis_only=False)
class _LinkedLowering(NativeLowering):
    """From Numba's language to LLVM's, and no further."""

    _name = "linked_lowering"

    def run_pass(self, state: Any) -> bool:
        """The pass."""
        context = state.targetctx
        library = _LinkedLibrary(context.codegen(), state.func_id.func_qualname)
        state.library = library
        state.flags.no_compile = True
        NativeLowering.run_pass(self, state)
        lowered = state["cr"]
        described = lowered.fndesc
        # Callers know a function by an object; nothing can call this one.
        known_as = _dynfunc.make_function(described.lookup_module(), described.qualname, "", 0, lowered.env, (library,))
        context.insert_user_function(known_as, described, [library])
        if hasattr(library, "_reload_init"):  # absent from Numba 0.60
            state.reload_init.extend(library._reload_init)
        state["cr"] = lowered._replace(cfunc=known_as)
        return True


class LinkedCompiler(CompilerBase):
    """`pipeline_class` of `numba.njit` for what has neither of Numba's wrappers."""

    def define_pipelines(self) -> list[Any]:
        """Numba's own passes but for the last step."""
        manager = DefaultPassBuilder.define_nopython_pipeline(self.state)
        manager.passes = [
            (_LinkedLowering if step is NativeLowering else step, words) for step, words in manager.passes
        ]
        manager.finalize()
        return [manager]
