"""Machine code for what is called from outside only.

A kernel takes in the functions that it calls as LLVM's intermediate code. Numba nevertheless optimises each of these to
the end and translates it to machine code, although nobody ever asks for its address: a sixth of a cold start. Here the
last passes and the translation wait until an address is asked for; for what is never asked for, they never come.
"""

from __future__ import annotations

from typing import Any

from numba.core.codegen import JITCodeLibrary, JITCPUCodegen
from numba.core.environment import lookup_environment

_ENVIRONMENT = "_ZN08NumbaEnv"  # how the names begin of what a function knows of its Python module


class LibraryOnDemand(JITCodeLibrary):
    """The code of a function and of what it calls. What comes from the cache is machine code from the beginning."""

    _awaited = False  # compiled here, and not yet asked for

    def finalize(self) -> None:
        """Take in what is called, and stop where that can be taken in by others."""
        self._awaited = True
        super().finalize()

    def get_pointer_to_function(self, name: str) -> int:
        """The address of a function, 0 where it is not in here. It is compiled to the end now."""
        self._ensure_finalized()
        if self._awaited and any(function.name == name for function in self.get_defined_functions()):
            self._awaited = False
            self._run(*self._codegen._module_pass_manager())
            self._final_module.verify()
            self._finalize_final_module()
            self._fill_in_environments()
        address: int = super().get_pointer_to_function(name)
        return address

    def _optimize_final_module(self) -> None:
        """The first of Numba's two rounds: calls merged, and counts of references that cancel out removed."""
        options = {"loop_vectorize": False, "slp_vectorize": False, "opt": 0, "cost": "cheap"}
        self._run(*self._codegen._module_pass_manager(**options))

    def _run(self, passes: Any, builder: Any) -> None:
        passes.run(self._final_module, builder)

    def _finalize_final_module(self) -> None:
        if self._awaited:
            self._finalize_dynamic_globals()
            self._finalized = True
        else:
            super()._finalize_final_module()

    def _fill_in_environments(self) -> None:
        """Of what was taken in: at its own time there was no address to write them to."""
        for variable in self._final_module.global_variables:
            environment = lookup_environment(variable.name) if variable.name.startswith(_ENVIRONMENT) else None
            if environment is not None:
                self.codegen.set_env(variable.name, environment)


class CodegenOnDemand(JITCPUCodegen):
    """Numba's own, with these libraries."""

    _library_class = LibraryOnDemand

    def set_env(self, env_name: str, env: Any) -> None:
        """Write an environment where compiled code looks for it; nowhere as long as there is none."""
        if self._engine.is_symbol_defined(env_name):
            super().set_env(env_name, env)
