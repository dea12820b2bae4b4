"""The main memory of a run, said before it begins."""

from dataclasses import dataclass

PICTURE = 12.0  # bytes of a pixel of a picture in float32, red, green and blue


@dataclass(frozen=True, kw_only=True)
class Memory:
    """Figures of a method, as `scripts/bench_memory.py` measures them on captures of several sizes.

    Attributes:
        fixed: Bytes whatever the capture, libraries included.
        point: Bytes for each of the first points.
        pictures: How many float32 pictures of all training views are there at once.
        work: How many pictures of its size the work on one view takes.
    """

    fixed: float = 0.5e9
    point: float = 1100.0
    pictures: float = 2.0
    work: float = 48.0

    def peak(self, views: float, pixels: float, points: float) -> float:
        """Bytes at the peak of a run on the CPU.

        Args:
            views: Training views.
            pixels: Of one view.
            points: First points.
        """
        return self.fixed + self.point * points + PICTURE * pixels * (self.pictures * views + self.work)
