"""What some tests need and not every machine has: said once, with the reason why its absence is no failure."""

from pathlib import Path

import pytest

from simscenes.backend import backend_status

FOX = Path(__file__).resolve().parents[2] / "shared" / "data" / "fox"


@pytest.fixture(scope="session")
def fox() -> Path:
    """A folder of fifty real photographs with a transforms.json."""
    if not FOX.is_dir():
        # They are other people's, so they lie beside a checkout and are never part of it: a stranger's clone has none.
        # What they show is tested there on folders that the tests write.
        pytest.skip("the fox photographs are not beside this checkout")
    return FOX


@pytest.fixture(scope="session")
def jit() -> None:
    """A Mitsuba variant that compiles kernels for whole arrays of rays."""
    if not (backend_status("llvm_ad")[0] or backend_status("cuda_ad")[0]):
        # Where nobody may install libLLVM, novags renders with a scalar variant: that is slow but allowed, and this
        # machinery then has no part in it. Everything else is tested there too.
        pytest.skip(f"only scalar Mitsuba variants work here: {backend_status('llvm_ad')[1]}")
