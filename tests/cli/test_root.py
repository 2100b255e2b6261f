"""What root asks for in folders of another user, who has put links there."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
from tests.fixtures.archive import make_empty
from tests.fixtures.ports import free_port
from tests.formats.conftest import LENS, document_of

from sunarc.common.errors import OutsideError
from sunarc.imager.archive.database.state_folder import as_owner

if TYPE_CHECKING:
    from tests.fixtures.command_line import Sunarc

pytestmark = pytest.mark.skipif(os.geteuid() != 0, reason="only root follows where others may not go")

USER, GROUP = 12345, 12346
OTHER = b"of another, and nobody's to change\n"
Snapshot = dict[str, tuple[bytes, int, int, int]]


@dataclass(frozen=True, slots=True)
class Place:
    """A state folder of `USER` with a database, and a folder of root's that nobody else may write into."""

    state: Path
    victims: Path

    def by_user(self, script: str) -> None:
        """Run a line of Python as the user, in the state folder; `V` is the folder of root's."""
        prelude = f"import os; from pathlib import Path; os.chdir({str(self.state)!r}); V = Path({str(self.victims)!r})"
        subprocess.run(
            [sys.executable, "-c", f"{prelude}\n{script}"], check=True, user=USER, group=GROUP, extra_groups=[]
        )

    def seen(self) -> Snapshot:
        """Return content, mode and owner of all in root's folder."""
        seen = Snapshot()
        for file in (self.victims, *self.victims.rglob("*")):
            found = file.lstat()
            content = file.read_bytes() if file.is_file() else b""
            seen[str(file)] = content, found.st_mode, found.st_uid, found.st_gid
        return seen

    def owners(self) -> set[tuple[int, int]]:
        """Return users and groups of all in the state folder."""
        return {(file.lstat().st_uid, file.lstat().st_gid) for file in (self.state, *self.state.rglob("*"))}


@pytest.fixture
def place() -> Iterator[Place]:
    base = Path(tempfile.mkdtemp(prefix="sunarc-root-", dir="/tmp"))
    base.chmod(0o755)
    made = Place(base / "theirs" / "state", base / "victims")
    made.state.mkdir(parents=True)
    make_empty(made.state / "sunarc.sqlite")
    (made.state / "backups").mkdir()
    shutil.copy(made.state / "sunarc.sqlite", made.state / "backups" / "sunarc-20260101T000000Z.sqlite")
    for file in (made.state.parent, made.state, *made.state.rglob("*")):
        os.chown(file, USER, GROUP)
    image = made.victims / "images" / "2013" / "05" / "13" / "20130513T120000.000Z_hdr.png"
    image.parent.mkdir(parents=True)
    image.write_bytes(OTHER)
    (made.victims / "copies").mkdir()
    shutil.copy(made.state / "sunarc.sqlite", made.victims / "copies" / "sunarc-20260101T000000Z.sqlite")
    shutil.copy(made.state / "sunarc.sqlite", made.victims / "secret.sqlite")
    (made.victims / "secret.sqlite").chmod(0o600)
    (made.victims / "file").write_bytes(OTHER)
    (made.victims / "empty").write_bytes(b"")
    yield made
    shutil.rmtree(base)


COMMANDS = [
    ("upgrade",),
    ("check",),
    ("downgrade", "--to", "0001"),
    ("backup", "STATE/backups", "--keep", "1"),
    ("backup", "STATE/copy.sqlite"),
    ("restore", "--latest"),
    ("export", "STATE/everything"),
]
ATTACKS = {
    "lock": "Path('lock').symlink_to(V / 'file')",
    "database": "os.unlink('sunarc.sqlite'); Path('sunarc.sqlite').symlink_to(V / 'empty')",
    "log": "Path('sunarc.sqlite-wal').symlink_to(V / 'file'); Path('sunarc.sqlite-shm').symlink_to(V / 'file')",
    "journal": "Path('sunarc.sqlite-journal').symlink_to(V / 'file')",
    "temporary": "[Path(n + '.partial').symlink_to(V / 'file') for n in ('sunarc.sqlite', 'copy.sqlite')]",
    "temporary_journal": "Path('sunarc.sqlite.partial-journal').symlink_to(V / 'file')",
    "target": "Path('copy.sqlite').symlink_to(V / 'new'); Path('everything').symlink_to(V / 'copies')",
    "copies": "import shutil; shutil.rmtree('backups'); Path('backups').symlink_to(V / 'copies')",
    "images": "Path('images').symlink_to(V / 'images')",
    "folder": "os.rename('../state', '../was'); Path('../state').symlink_to(V)",
}


def words(place: Place, command: tuple[str, ...]) -> list[str]:
    return ["db", *(word.replace("STATE", str(place.state)) for word in command), "--state", str(place.state)]


@pytest.mark.parametrize("attack", ATTACKS)
@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_no_link_in_a_state_folder_leads_root_out_of_it(
    sunarc: Sunarc, place: Place, command: tuple[str, ...], attack: str
) -> None:
    place.by_user(ATTACKS[attack])
    before = place.seen()
    answer = sunarc(*words(place, command))
    assert "Traceback" not in answer.err
    assert place.seen() == before
    assert os.geteuid() == 0


@pytest.mark.parametrize("name", ["lock", "sunarc.sqlite-wal", "sunarc.sqlite.partial", "sunarc.sqlite"])
@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_no_hard_link_in_a_state_folder_has_root_change_what_the_user_may_not(
    sunarc: Sunarc, place: Place, command: tuple[str, ...], name: str
) -> None:
    (place.state / name).unlink(missing_ok=True)
    os.link(place.victims / "file", place.state / name)  # of a kernel without fs.protected_hardlinks
    before = place.seen()
    assert "Traceback" not in sunarc(*words(place, command)).err
    assert place.seen() == before


RACE = """
import os, sys
victim, *names = sys.argv[1:]
while True:
    for name in names:
        try:
            os.symlink(victim, name)
        except OSError:
            pass
"""


@contextlib.contextmanager
def racing(place: Place, victim: str, *names: str) -> Iterator[None]:
    """Have the user put links back as soon as they are removed."""
    command = [sys.executable, "-c", RACE, str(place.victims / victim), *(str(place.state / name) for name in names)]
    with subprocess.Popen(command, user=USER, group=GROUP, extra_groups=[]) as attacker:
        try:
            yield
        finally:
            attacker.kill()


def test_links_put_back_while_root_restores_lead_nowhere(sunarc: Sunarc, place: Place) -> None:
    before = place.seen()
    with racing(place, "empty", "sunarc.sqlite.partial", "sunarc.sqlite-wal", "sunarc.sqlite", "lock"):
        for _ in range(20):
            sunarc(*words(place, ("restore", "--latest")))
    assert place.seen() == before


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_what_root_leaves_in_a_state_folder_belongs_to_its_owner(
    sunarc: Sunarc, place: Place, command: tuple[str, ...]
) -> None:
    assert sunarc(*words(place, command)).code == 0
    assert place.owners() == {(USER, GROUP)}


def test_a_copy_that_the_owner_may_not_read_is_not_given_to_it(sunarc: Sunarc, place: Place) -> None:
    place.by_user("Path('mine.sqlite').symlink_to(V / 'secret.sqlite')")
    answer = sunarc(*words(place, ("restore", "STATE/mine.sqlite")))
    assert (answer.code, "Permission denied" in answer.err) == (2, True)


def test_a_target_that_the_owner_may_not_write_is_one_line_with_its_name(sunarc: Sunarc, place: Place) -> None:
    answer = sunarc(*words(place, ("backup", str(place.victims / "copy.sqlite"))))
    assert (answer.code, answer.err.count("\n")) == (3, 1)
    assert str(place.victims / "copy.sqlite") in answer.err
    place.victims.chmod(0o700)
    hidden = sunarc(*words(place, ("backup", str(place.victims / "copy.sqlite"))))
    assert (hidden.code, hidden.err.count("\n")) == (3, 1)
    assert str(USER) in hidden.err


@pytest.mark.parametrize("mode", [0o777, 0o775])
def test_a_folder_of_roots_that_others_may_write_is_refused(sunarc: Sunarc, place: Place, mode: int) -> None:
    os.chown(place.state.parent, 0, 0)
    os.chown(place.state, 0, GROUP)
    place.state.chmod(mode)
    answer = sunarc(*words(place, ("upgrade",)))
    assert (answer.code, f"{place.state} belongs to root" in answer.err) == (3, True)


@pytest.mark.parametrize("mode", [0o777, 0o775, 0o1777])
def test_a_missing_folder_that_others_could_make_first_is_refused(sunarc: Sunarc, place: Place, mode: int) -> None:
    shared = place.victims.parent / "shared"
    shared.mkdir()
    shared.chmod(mode)
    for state in (shared / "state", shared / "state" / "deeper"):
        answer = sunarc(*words(place, ("upgrade",))[:-1], str(state))
        assert (answer.code, answer.err.count("\n")) == (3, 1)
        assert str(shared) in answer.err
        assert not (shared / "state").exists()
    shared.chmod(0o755)
    with as_owner(shared / "state"):
        assert os.geteuid() == 0


@pytest.mark.parametrize("call", ["setgroups", "setegid", "seteuid"])
def test_root_is_itself_again_after_half_a_change_of_identity(
    place: Place, monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    before, change = (os.geteuid(), os.getegid(), os.getgroups()), getattr(os, call)

    def fail(wanted: object) -> None:
        if wanted not in before:
            raise PermissionError(1, "Operation not permitted")
        change(wanted)

    monkeypatch.setattr(os, call, fail)
    with pytest.raises(OutsideError, match=str(USER)), as_owner(place.state):
        pass
    assert (os.geteuid(), os.getegid(), os.getgroups()) == before


def test_what_may_not_be_done_without_a_file_is_named_by_the_folder(place: Place) -> None:
    with pytest.raises(OutsideError, match=f"^{place.state} "), as_owner(place.state):
        os.setgroups([1, 2, 3])


def test_a_link_of_roots_to_the_owners_folder_is_followed(sunarc: Sunarc, place: Place) -> None:
    moved = place.victims.parent / "moved"
    moved.symlink_to(place.state)
    assert sunarc("db", "restore", "--latest", "--state", str(moved)).code == 0
    assert place.owners() == {(USER, GROUP)}


def test_commands_with_settings_act_as_the_owner(sunarc: Sunarc, place: Place) -> None:
    config, points = place.victims.parent / "sunarc.toml", place.victims.parent / "points.csv"
    config.write_text(f'name = "roof"\nstate = "{place.state}"\n[site]\nlatitude = 36.6\nlongitude = -97.5\n')
    points.write_text("time_utc,x_px,y_px,sigma_px,body\n2013-05-13T18:30:00Z,871.5,883.25,0.01,sun\n")
    given = ("--config", str(config))
    assert sunarc("points", "import", str(points), "--image-size", "1748,1748", *given).code == 0
    assert sunarc("calibrations", "list", *given).code == 0
    assert place.owners() == {(USER, GROUP)}
    place.by_user("Path('lock').symlink_to(V / 'file')")
    before = place.seen()
    assert sunarc("calibrate", *given).code == 3
    assert place.seen() == before


def test_init_follows_no_link_of_another_users_folder(
    sunarc: Sunarc, place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(place.state)
    (place.state / "pictures").mkdir()
    place.by_user("Path('sunarc-init.png').symlink_to(V / 'file'); Path('sunarc.toml').symlink_to(V / 'file')")
    before = place.seen()
    site = ("--latitude", "36.6", "--longitude", "-97.5", "--altitude", "318")
    source = ("--folder", str(place.state / "pictures"), "--state", str(place.state))
    sunarc("init", str(place.state / "sunarc.toml"), *site, *source)
    place.by_user("os.unlink('sunarc.toml')")
    sunarc("init", str(place.state / "sunarc.toml"), *site, *source)
    assert place.seen() == before
    found = (place.state / "sunarc.toml").stat()
    assert (found.st_uid, found.st_gid) == (USER, GROUP)


def known_camera(place: Place) -> str:
    """Write a calibration document that everybody may read, and return its path."""
    small = replace(LENS, width=220, height=200, focal_length_px=(75.0, 75.0), principal_point_px=(110.0, 100.0))
    path = place.victims.parent / "calibration.json"
    path.write_text(json.dumps(document_of(small)))
    return str(path)


OUTPUTS = {
    "export": ("export", "--calibration", "CALIBRATION", "--format", "opencv", "-o", "STATE/out/file"),
    "export of a set": ("export", "--calibration", "CALIBRATION", "--format", "azimuth-zenith-png", "-o", "STATE/link"),
    "compare": ("compare", "CALIBRATION", "CALIBRATION", "--differences", "STATE/out/file.npz"),
    "reanalyse": (
        "reanalyse",
        "PICTURES",
        "--yes",
        "--utc-offset",
        "0",
        "--latitude",
        "36.6",
        "--longitude",
        "-97.5",
        "-o",
        "STATE/link",
    ),
    "study": ("study", "shadow", "--out", "STATE/link"),
}


@pytest.mark.parametrize("name", OUTPUTS)
def test_no_link_leads_what_root_writes_into_another_users_folder_out_of_it(
    sunarc: Sunarc, place: Place, name: str
) -> None:
    pictures = place.victims.parent / "pictures"
    pictures.mkdir()
    cv2.imwrite(str(pictures / "image-20130513180000.jpg"), np.full((60, 80), 90, dtype=np.uint8))
    place.by_user(
        "os.mkdir('out'); os.symlink(V / 'file', 'out/file'); os.symlink(V / 'file', 'out/file.npz'); "
        "os.symlink(V / 'copies', 'link')"
    )
    files = {"STATE": str(place.state), "CALIBRATION": known_camera(place), "PICTURES": str(pictures)}
    before, words = place.seen(), list(OUTPUTS[name])
    for key, path in files.items():
        words = [word.replace(key, path) for word in words]
    answer = sunarc(*words)
    assert "Traceback" not in answer.err
    assert (answer.code in {2, 3}, place.seen()) == (True, before), answer.err
    assert "ermission denied" in answer.err or str(USER) in answer.err


def test_what_root_writes_into_another_users_folder_belongs_to_that_user(sunarc: Sunarc, place: Place) -> None:
    target = place.state / "fisheye.yml"
    words = ("export", "--calibration", known_camera(place), "--format", "opencv", "-o", str(target))
    assert sunarc(*words).code == 0
    assert (target.stat().st_uid, target.stat().st_gid) == (USER, GROUP)
    assert os.geteuid() == 0


def test_a_simulated_camera_of_root_follows_no_link_of_another_users_folder(place: Place) -> None:
    place.by_user(
        "os.mkdir('pictures'); os.symlink(V / 'file', 'truth.json'); os.symlink(V / 'copies', 'pictures/2013')"
    )
    before = place.seen()
    out = ("--folder", str(place.state / "pictures"), "--truth", str(place.state / "truth.json"))
    command = [sys.executable, "-m", "sunarc", "simulate", *out]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=100.0)
    assert (done.returncode, "Traceback" in done.stderr) == (3, False)
    assert place.seen() == before


def test_a_service_that_root_starts_acts_as_the_owner_of_its_state(place: Place) -> None:
    place.by_user("Path('images').symlink_to(V / 'images')")
    before = place.seen()
    pictures = place.victims.parent / "pictures"
    pictures.mkdir()
    config = place.victims.parent / "sunarc.toml"
    config.write_text(
        f'name = "roof"\nsource = "folder"\nstate = "{place.state}"\n[site]\nlatitude = 36.6\nlongitude = -97.5\n'
        f'[folder]\npath = "{pictures}"\n[api]\nport = {free_port()}\n[disk]\nkeep_free_mb = 1e9\n'
    )
    command = [sys.executable, "-m", "sunarc", "serve", "--config", str(config)]
    refused = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60.0)
    assert (refused.returncode, f"{place.state}/images: Permission denied" in refused.stderr) == (3, True)
    assert place.seen() == before
    assert place.owners() == {(USER, GROUP)}
