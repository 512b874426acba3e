"""How long the variables of a function live, found out when somebody asks.

Numba finds out anew after most of its passes which variables are alive where. Three passes ask; the others are done
faster without: a fourteenth of a cold start.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from numba.core import ir, transforms
from numba.core.postproc import PostProcessor, VariableLifetime

_LEAVES = {type(None), bool, int, float, str, ir.Loc, ir.Arg, ir.Const, ir.Global, ir.FreeVar}  # what has no variables
_find_out_now = PostProcessor.run


def _run(self: PostProcessor, emit_dels: bool = False, extend_lifetimes: bool = False) -> None:
    """As Numba's own, but for the variables that are alive where a block begins: only generators have to know."""
    function = self.func_ir
    if function.is_generator:
        _find_out_now(self, emit_dels, extend_lifetimes)
        return
    function.blocks = transforms.canonicalize_cfg(function.blocks)
    function.variable_lifetime, function.generator_info = VariableLifetime(function.blocks), None
    if emit_dels:
        self._insert_var_dels(extend_lifetimes=extend_lifetimes)


def _variables_of_statement(self: ir.Stmt) -> list[ir.Var]:
    found: list[ir.Var] = []
    _collect(vars(self).values(), found)
    return found


def _variables_of_expression(self: ir.Expr) -> list[ir.Var]:
    found: list[ir.Var] = []
    _collect(self._kws.values(), found)
    return found


def _collect(parts: Iterable[Any], found: list[ir.Var]) -> None:
    """Variables in parts of an instruction, in order. Numba's own way makes a list for each part of a part."""
    for part in parts:
        kind = type(part)
        if kind is ir.Var:
            found.append(part)
        elif kind is ir.Expr:
            _collect(part._kws.values(), found)
        elif isinstance(part, list | tuple):
            _collect(part, found)
        elif isinstance(part, dict):
            _collect(part.values(), found)
        elif kind not in _LEAVES and isinstance(part, ir.Inst):
            found.extend(part.list_vars())


def ask_for_lifetimes() -> None:
    """Tell Numba."""
    PostProcessor.run = _run  # type: ignore[method-assign]
    ir.Stmt.list_vars = _variables_of_statement  # type: ignore[method-assign]
    ir.Expr.list_vars = _variables_of_expression  # type: ignore[method-assign]
