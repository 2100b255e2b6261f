"""Files that others made: what is opened, and how names become texts."""

from __future__ import annotations

import json
import os
import random
import socket
import subprocess
import sys
import threading
import unicodedata
from collections.abc import Iterator
from pathlib import Path

import pytest

from sunarc.common.foreign_files import UnfitFileError, is_regular, name_path, name_text, open_regular, read_regular


def test_a_regular_file_is_read_through_links(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"content")
    (tmp_path / "link").symlink_to("a")
    assert read_regular(tmp_path / "link") == b"content"
    assert is_regular(tmp_path / "link")


def unfit(folder: Path) -> Iterator[Path]:
    os.mkfifo(folder / "pipe.jpg")
    (folder / "zero.jpg").symlink_to("/dev/zero")
    (folder / "folder.jpg").mkdir()
    with socket.socket(socket.AF_UNIX) as one:
        one.bind(str(folder / "socket.jpg"))
    return folder.iterdir()


def test_what_is_no_regular_file_is_refused_at_once(tmp_path: Path) -> None:
    paths = list(unfit(tmp_path))
    assert len(paths) == 4
    for path in paths:
        assert not is_regular(path)
        for read in (open_regular, read_regular):
            with pytest.raises(UnfitFileError, match="not a regular file"):
                read(path)


def test_a_file_is_read_up_to_the_limit_and_none_that_is_larger(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(bytes(1000))
    assert len(read_regular(path, most_bytes=1000)) == 1000
    with pytest.raises(UnfitFileError, match="999"):
        read_regular(path, most_bytes=999)
    os.truncate(path, 1 << 40)  # 1 TB that takes no room
    with pytest.raises(UnfitFileError, match="larger"):
        read_regular(path)


def read_again_and_again(path: Path) -> None:
    while True:
        read_regular(path, most_bytes=1_000_000)


def test_a_file_that_grows_without_end_is_refused(tmp_path: Path) -> None:
    path, stop = tmp_path / "a", threading.Event()
    path.write_bytes(bytes(1000))

    def grow() -> None:
        with path.open("ab", buffering=0) as file:
            while not stop.is_set() and file.tell() < 100_000_000:
                file.write(bytes(100_000))

    writer = threading.Thread(target=grow)
    writer.start()
    try:
        with pytest.raises(UnfitFileError):
            read_again_and_again(path)
    finally:
        stop.set()
        writer.join()


NAMES = [
    b"image-20250513150000.jpg", "Überblick 日本.jpg".encode(), b"a\xff\xfe.jpg", b"a\nb\r\x1b[31m.jpg", b"\x80" * 255,
    b"a\\x41.jpg", b"a\\b.jpg", "\u202egpj.exe".encode(), b"\xed\xb3\xbf.jpg", b"\xc2\x85.jpg", b"\x7f.jpg",
]  # fmt: skip


def random_names(n: int) -> Iterator[bytes]:
    rng = random.Random(5)
    parts = [b"\\x", b"\\", b"41", "é".encode(), unicodedata.normalize("NFD", "é").encode(), b"\xff", b"\n", b"A", b"a"]
    for _ in range(n):
        made = b"".join(
            bytes([rng.randrange(1, 256)]) if rng.random() < 0.6 else rng.choice(parts)
            for _ in range(rng.randrange(1, 80))
        )
        yield made.replace(b"/", b"_")[:255]


def test_every_name_becomes_a_text_of_its_own_and_comes_back() -> None:
    names = {*NAMES, *random_names(10_000)}
    texts = {name: name_text(os.fsdecode(name)) for name in names}
    assert len(set(texts.values())) == len(names)
    for name, text in texts.items():
        assert os.fsencode(name_path(text)) == name
        assert json.loads(json.dumps(text, ensure_ascii=False).encode("utf-8")) == text
        assert not any(unicodedata.category(one) in {"Cc", "Cs", "Zl", "Zp"} for one in text)


def test_a_usual_name_is_its_own_text_and_others_show_their_bytes() -> None:
    for usual in ("image-20250513150000.jpg", "2025/Überblick 日本.jpg", "a\\b.jpg", unicodedata.normalize("NFD", "é")):
        assert name_text(usual) == usual
    assert name_text(os.fsdecode(b"a\xff\n.jpg")) == "a\\xff\\x0a.jpg"
    assert name_text("a\\x41.jpg") == "a\\x5cx41.jpg"


def test_the_text_does_not_depend_on_the_locale() -> None:
    name = r"os.fsdecode(b'\xc3\xa9\xff')"
    code = f"import os; from sunarc.common.foreign_files import name_text; print(ascii(name_text({name})))"
    found = {
        subprocess.run(
            [sys.executable, "-c", code], env={**os.environ, "LC_ALL": locale}, check=True, capture_output=True
        ).stdout
        for locale in ("C", "C.UTF-8", "POSIX")
    }
    assert found == {b"'\\xe9\\\\xff'\n"}
