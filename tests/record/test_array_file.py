"""No file of arrays makes the reader execute, wait, or take more memory than the file is
allowed.
"""

from __future__ import annotations

import io
import os
import pickle
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from uvms_ocp.errors import InvalidInput
from uvms_ocp.record import array_file
from uvms_ocp.record.array_file import read_arrays


def npy(array: np.ndarray, **header: object) -> bytes:
    """An array as a file; header: what to say of it instead of the truth."""
    file = io.BytesIO()
    stated_header = {
        "descr": array.dtype.str,
        "fortran_order": False,
        "shape": array.shape,
        **header,
    }
    np.lib.format.write_array_header_1_0(file, stated_header)
    return file.getvalue() + array.tobytes()


def archive(path: Path, **members: bytes) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, content in members.items():
            file.writestr(name.replace("__", "."), content)
    return path


ONE = np.ones(3)


class Trap:
    """Executes something when it is unpickled."""

    def __reduce__(self) -> tuple[Callable[..., object], tuple[str]]:
        return os.mkdir, ("trap",)


LIES = {
    "more numbers than there are": (npy(ONE, shape=(10**12,)), "declares float64 of shape"),
    "numbers without an end": (npy(ONE, shape=(10**40,)), "declares float64 of shape"),
    "fewer than there are": (npy(ONE, shape=(2,)), "holds 24 bytes"),
    "a negative number of them": (npy(ONE, shape=(-3,)), "declares"),
    "two negative numbers": (npy(ONE, shape=(-3, -1)), "declares"),
    "larger ones": (npy(ONE, descr="<f4"), "declares float32"),
    "objects": (npy(ONE, descr="|O"), "holds object; numbers and text are read"),
    "records": (npy(ONE, descr=[("a", "<f8")]), "numbers and text"),
    "times": (npy(ONE, descr="<M8[s]"), "numbers and text"),
    "nothing": (b"", "damaged, or no .npz file"),
    "half a header": (npy(ONE)[:40], "damaged, or no .npz file"),
    "another format": (b"\x93NUMPY\x09\x00" + npy(ONE)[8:], "damaged|format"),
    "a header of another language": (npy(ONE).replace(b"(3,)", b"(3L)"), "damaged"),
    "a header that does not end": (npy(ONE).replace(b"}", b"("), "damaged"),
    "a header that is called": (npy(ONE).replace(b"(3,)", b"f(3)"), "damaged"),
}


@pytest.mark.parametrize("lie", LIES)
def test_a_header_that_lies_is_refused_before_memory_is_taken(lie: str, tmp_path: Path) -> None:
    content, message = LIES[lie]
    path = archive(tmp_path / "a.npz", a__npy=content)
    tracemalloc.start()
    with pytest.raises(InvalidInput, match=message) as caught:
        read_arrays(path)
    _, peak_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak_bytes < 1 << 20
    assert "\n" not in str(caught.value)


def test_a_file_that_is_not_there_is_not_called_damaged(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="No such file or directory; give the path"):
        read_arrays(tmp_path / "a.npz")


def test_a_small_file_of_many_zeros_is_not_unpacked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = archive(tmp_path / "a.npz", a__npy=npy(np.zeros(1 << 20)))
    assert path.stat().st_size < 1 << 14
    assert len(read_arrays(path)["a"]) == 1 << 20
    monkeypatch.setattr(array_file, "SMALL", 1 << 20)
    with pytest.raises(
        InvalidInput, match=r"0\.00839 GB of arrays in 0\.008\d\d MB; at most 400 times a file"
    ):
        read_arrays(path)


@pytest.mark.parametrize(("more", "refused"), [(0, False), (1, True)])
def test_what_a_file_may_unpack_to_grows_with_it(more: int, refused: bool, tmp_path: Path) -> None:
    """By its own word: nothing of it is there, and none of it is read where it says too much."""
    path = archive(
        tmp_path / "a.npz", a__npy=npy(ONE), b__npy=np.random.default_rng(0).bytes(1 << 18)
    )
    stated_size = array_file.DENSEST * path.stat().st_size - (1 << 18) + more
    assert stated_size > array_file.SMALL
    content = path.read_bytes()
    place = (
        content.rindex(b"PK\x01\x02", 0, content.rindex(b"PK\x01\x02")) + 24
    )  # the size in the list of members
    path.write_bytes(content[:place] + stated_size.to_bytes(4, "little") + content[place + 4 :])
    with pytest.raises(
        InvalidInput, match=r"at most 400 times a file are read" if refused else r"'a' declares"
    ):
        read_arrays(path)


def test_a_directory_that_hides_the_size_is_found_out(tmp_path: Path) -> None:
    path = archive(tmp_path / "a.npz", a__npy=npy(np.zeros(1 << 16)))
    size = (1 << 19) + len(npy(np.zeros(0)))
    lie = len(npy(ONE))
    content = path.read_bytes()
    path.write_bytes(content.replace(size.to_bytes(4, "little"), lie.to_bytes(4, "little")))
    with pytest.raises(InvalidInput, match=r"damaged|declares"):
        read_arrays(path)


def test_nothing_is_unpickled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    bare = tmp_path / "bare.npz"
    packed = tmp_path / "packed.npz"
    bare.write_bytes(pickle.dumps(Trap()))
    np.savez(packed, a=np.array([Trap()], dtype=object))
    for path in (bare, packed):
        with pytest.raises(InvalidInput):
            read_arrays(path)
    assert not (tmp_path / "trap").exists()


def test_other_members_two_of_one_name_and_very_many_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match=r"'a\.txt' in it is no array"):
        read_arrays(archive(tmp_path / "a.npz", a__txt=b"x"))
    with pytest.raises(InvalidInput, match="300 arrays; at most 256 are read"):
        read_arrays(archive(tmp_path / "b.npz", **{f"a{i}__npy": npy(ONE) for i in range(300)}))
    path = archive(tmp_path / "c.npz", a__npy=npy(ONE), b__npy=npy(ONE))
    path.write_bytes(path.read_bytes().replace(b"b.npy", b"a.npy"))
    with pytest.raises(InvalidInput, match=r"two arrays of one name|damaged"):
        read_arrays(path)


def test_arrays_are_what_was_saved(tmp_path: Path) -> None:
    saved = {
        "scalar": np.array(2.5),
        "none": np.zeros((0, 4)),
        "fortran": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        "flags": np.array([True, False]),
        "text": np.array("é\n"),
        "counts": np.arange(5, dtype=np.int32),
    }
    np.savez_compressed(tmp_path / "a.npz", **saved)
    loaded = read_arrays(tmp_path / "a.npz")
    assert list(loaded) == list(saved)
    for name, array in saved.items():
        assert loaded[name].dtype == array.dtype
        np.testing.assert_array_equal(loaded[name], array)
        assert not loaded[name].flags.writeable
