"""Where pictures and data of a page go: into it while they are few, else beside it, with thumbnails in the page."""

import base64
import hashlib
import io
import json
import re
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from sensor_model.files.atomic import atomic
from sensor_model.files.door import read_bytes

INSIDE = 14_000_000  # bytes of text that pictures and data may take in a page: with the rest it stays below 20 MB
THUMB = 144  # px, longest side
SMALL = 80  # px; of thumbnails where there are more than `MANY`
MANY = 500
EXACT_PIXELS = 256 * 256  # of larger pictures codes are not kept: noise compresses badly, and pages grow by megabytes
LOSSY, SMALLEST = 85, 75  # quality of whole pictures whose codes are not kept, and of thumbnails
OWN = re.compile(
    r"[0-9a-f]{20}\.(webp|png|jpg|js)"
)  # files beside a page, by earlier versions too; others are not ours


@dataclass
class Picture:
    """A picture of a page."""

    data: bytes | None  # as WebP; None once it lies in the file `full`
    exact: bool  # whether its codes equal the codes of the given picture
    src: str = ""  # what the page shows, a data URI: the whole picture, or a thumbnail of it
    full: str | None = None  # where the whole picture is, relative to the page; None if `src` is that


@dataclass
class Script:
    """Data of a page, as text that a script can read."""

    text: str  # the data; empty once they lie in `file`
    name: str  # by which the page asks for it
    inside: bool | None = None  # whether the page holds the text; None before `Album.settle`
    file: str | None = None  # where it is otherwise, relative to the page: a script that hands the text over


@dataclass
class Album:
    """The pictures and the data of one page.

    Pictures that do not fit into the page are written beside it as they come, so that memory does not grow with it.
    """

    page: Path  # the HTML file
    inside: int = field(default_factory=lambda: INSIDE)  # bytes of text that they may take in the page
    _pictures: list[Picture] = field(default_factory=list)
    _scripts: list[Script] = field(default_factory=list)
    _written: set[str] = field(default_factory=set)
    _size: dict[str, int] = field(default_factory=lambda: {"pictures": 0, "data": 0})  # as text in the page

    @property
    def folder(self) -> Path:
        """What lies beside the page, if anything does."""
        return files_of(self.page)

    def add(self, image: np.ndarray, *, exact: bool = True) -> Picture:
        """A float image [h,w,3] in 0..1; `exact`: its codes are kept, unless it is larger than `EXACT_PIXELS`."""
        codes = np.ascontiguousarray(np.round(np.clip(image, 0.0, 1.0) * 255).astype(np.uint8)[..., ::-1])
        exact = exact and codes.shape[0] * codes.shape[1] <= EXACT_PIXELS
        return self.add_encoded(_lossless(codes) if exact else _encoded(codes, LOSSY), exact=exact)

    def add_encoded(self, data: bytes, *, exact: bool) -> Picture:
        """A picture that is encoded already.

        Raises:
            OSError: If it does not fit into the page and cannot be written beside it.
        """
        self._pictures.append(Picture(data, exact))
        self._size["pictures"] += len(data) * 4 // 3
        if self._size["pictures"] > self.inside:
            for picture in reversed(self._pictures):
                if picture.data is None:  # and all before it
                    break
                picture.full, picture.data = self._write(picture.data, "webp"), None
        return self._pictures[-1]

    def add_data(self, name: str, data: bytes) -> Script:
        """Bytes that scripts of the page ask for by this name.

        Raises:
            OSError: If they do not fit into the page and cannot be written beside it.
        """
        self._scripts.append(Script(base64.b64encode(data).decode(), name))
        self._size["data"] += len(self._scripts[-1].text)
        if self._size["data"] > self.inside:
            for script in reversed(self._scripts):
                if script.file is not None:
                    break
                self._put_aside(script)
        return self._scripts[-1]

    def settle(self) -> None:
        """Choose the pictures for the page itself, write the rest beside it, and remove files of earlier pages there.

        Raises:
            OSError: If it cannot be written.
        """
        used, side = self._size["pictures"], THUMB if len(self._pictures) <= MANY else SMALL
        for picture in self._pictures:
            if picture.data is not None:
                picture.src = _uri(picture.data)
        if used > self.inside:
            for picture in self._pictures:
                picture.src = _thumbnail(read_bytes(self.page.parent / str(picture.full)), side)
            used = sum(len(picture.src) for picture in self._pictures)
        for script in self._scripts:
            script.inside = used + self._size["data"] <= self.inside
            if not script.inside and script.file is None:
                self._put_aside(script)
        self._forget()

    def _put_aside(self, script: Script) -> None:
        call = f"novags.probe.receive({json.dumps(script.name)}, {json.dumps(script.text)});\n"
        script.file, script.text = self._write(call.encode(), "js"), ""

    def _write(self, data: bytes, suffix: str) -> str:
        name = f"{hashlib.blake2b(data, digest_size=10).hexdigest()}.{suffix}"
        if name not in self._written:
            self.folder.mkdir(parents=True, exist_ok=True)
            with atomic(self.folder / name) as temporary:
                temporary.write_bytes(data)
            self._written.add(name)
        return f"{self.folder.name}/{name}"

    def _forget(self) -> None:
        if not self.folder.is_dir():
            return
        for path in self.folder.iterdir():
            if OWN.fullmatch(path.name) and path.name not in self._written:
                path.unlink()
        if not any(self.folder.iterdir()):
            self.folder.rmdir()


def files_of(page: Path) -> Path:
    """The folder of what lies beside a page."""
    return page.with_name(f"{page.stem}.files")


def _lossless(codes: np.ndarray) -> bytes:
    """All codes, in three quarters of the bytes of a PNG; OpenCV's way takes five times as long for 5 % less."""
    from PIL import Image

    found = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(codes[..., ::-1])).save(found, "webp", lossless=True, method=2, quality=50)
    return found.getvalue()


def _encoded(codes: np.ndarray, quality: int) -> bytes:
    done, data = cv2.imencode(".webp", codes, [cv2.IMWRITE_WEBP_QUALITY, quality])
    assert done
    return bytes(data.tobytes())


def _thumbnail(data: bytes, side: int) -> str:
    codes = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert codes is not None
    shrink = side / max(codes.shape[:2])
    if shrink < 1:
        size = (max(1, round(codes.shape[1] * shrink)), max(1, round(codes.shape[0] * shrink)))
        codes = cv2.resize(codes, size, interpolation=cv2.INTER_AREA)
    return _uri(_encoded(codes, SMALLEST))


def _uri(data: bytes) -> str:
    return f"data:image/webp;base64,{base64.b64encode(data).decode()}"
