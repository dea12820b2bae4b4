"""The EMVA 1288 package as an oracle, made to import."""

import warnings
from types import SimpleNamespace

import numpy as np
import pytest


@pytest.fixture(scope="session")
def emva1288() -> SimpleNamespace:
    """Its routines, Data1288 and Results1288."""
    if not hasattr(np, "asfarray"):  # emva1288 1.0.2 still calls what numpy 2 dropped
        np.asfarray = lambda a, dtype=np.float64: np.asarray(a, dtype=dtype)  # noqa: NPY201 - the shim itself
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its imports use deprecated names
        from emva1288.process import routines
        from emva1288.process.data import Data1288
        from emva1288.process.results import Results1288
    return SimpleNamespace(routines=routines, Data1288=Data1288, Results1288=Results1288)
