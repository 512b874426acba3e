"""Machine code comes when it is asked for, and nobody can tell the difference."""

import ctypes
import subprocess
import sys

import numba
import numpy as np
import pytest

from services.infra_lidar import jit
from services.infra_lidar.code_on_demand import LibraryOnDemand


@jit.inner
def _power(base, n):
    if n < 0:
        raise ValueError("no such power", n)
    return base * _power(base, n - 1) if n > 0 else 1.0


@jit.inner
def _tell(text, n):
    print("told", text, n)  # noqa: T201


@numba.njit
def powers(n):
    found = np.empty(n)
    for k in range(n):
        found[k] = _power(2.0, k)
    return found


def library_of(function) -> LibraryOnDemand:
    (compiled,) = function.overloads.values()
    return compiled.library


def test_only_what_is_called_from_python_becomes_machine_code():
    assert powers(5).tolist() == [1.0, 2.0, 4.0, 8.0, 16.0]
    assert not library_of(powers)._awaited
    assert library_of(_power)._awaited


def test_an_address_brings_the_code():
    @jit.inner
    def third(x):
        return x / 3.0

    third.compile((numba.float64,))
    (compiled,) = third.overloads.values()
    assert compiled.library._awaited
    assert compiled.library.get_pointer_to_function("nobody") == 0
    assert compiled.library._awaited
    address = compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name)
    assert address != 0
    assert not compiled.library._awaited
    numbers = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.POINTER(ctypes.c_double), ctypes.c_void_p, ctypes.c_double)
    result = ctypes.c_double()
    assert numbers(address)(ctypes.byref(result), None, 7.5) == 0
    assert result.value == 2.5


def test_functions_for_c_have_an_address():
    @numba.cfunc("float64(float64, float64)")
    def longer(a, b):
        return max(a, b)

    assert longer.ctypes(1.0, 2.0) == 2.0


def test_what_an_inner_function_raises_reaches_python():
    @numba.njit
    def fails(n):
        return _power(2.0, n)

    with pytest.raises(ValueError, match="no such power") as raised:
        fails(-3)
    assert raised.value.args == ("no such power", -3)


def test_an_inner_function_knows_its_constants(capfd: pytest.CaptureFixture[str]):
    @numba.njit
    def tells(n):
        _tell("this", n)
        print("and that", n)  # noqa: T201

    tells(3)
    assert capfd.readouterr().out == "told this 3\nand that 3\n"


KEPT = """
import numpy as np
from services.infra_lidar import ordering
from services.infra_lidar.jit import alone
rising = alone(ordering.rising)
print(rising(np.array([3.0, 1.0, 2.0])).tolist(), len(rising.stats.cache_hits))
"""


def test_kept_kernels_run_in_another_process(tmp_path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    said = [subprocess.run([sys.executable, "-c", KEPT], capture_output=True, text=True, check=True) for _ in range(2)]
    assert [one.stdout for one in said] == ["[1, 2, 0] 0\n", "[1, 2, 0] 1\n"]
