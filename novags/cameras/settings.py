"""Settings that sources of cameras share, and checks that refuse bad ones."""

from typing import Any, Literal, get_args

from novags.numbers import check_range

Pictures = Literal["raw", "enhanced", "denoised"]
Mapper = Literal["incremental", "global"]
Known = Literal["nothing", "lenses", "cameras"]  # what a network is told of the set's cameras
FEATURES = 10**6  # of a picture, at most
THREADS = 4096  # at most


def check_one_of(what: str, value: str, kinds: Any) -> None:
    """Raise a ValueError if `value` is not among the values of the Literal `kinds`."""
    if value not in get_args(kinds):
        raise ValueError(f"{what} must be one of {', '.join(get_args(kinds))}, got {value!r}")


def check_kind(source: str, kind: str) -> None:
    """Raise a ValueError if `kind` does not name pictures."""
    check_one_of(f"pictures of {source}", kind, Pictures)


def check_mapping(source: str, mapper: str, min_matches: int, max_error: float, threads: int) -> None:
    """Raise a ValueError if a setting that `sfm` and `hloc` share does not fit."""
    check_one_of(f"mapper of {source}", mapper, Mapper)
    if min_matches < 8:
        raise ValueError(
            f"{source} needs min_matches >= 8, because fewer do not fix a pair of cameras; got {min_matches}"
        )
    if not max_error > 0 or threads < 1:
        raise ValueError(f"max_error of {source} must be > 0 and threads >= 1, got {max_error} and {threads}")
    check_range(f"min_matches of {source}", min_matches, 8, FEATURES)
    check_range(f"threads of {source}", threads, 1, THREADS)


def check_drop(source: str, drop_percent: float) -> None:
    """Raise a ValueError if this share of pixels cannot be left out."""
    if not 0 <= drop_percent < 100:
        raise ValueError(f"drop_percent of {source} must lie in [0, 100), got {drop_percent}")
