"""Commands that are cut off, or refused by the disk, at each of their file operations; one JSON
value on stdout.

python interrupted.py killed|refused|full FOLDER: the same small set of files, written anew for every operation.
python interrupted.py commands FOLDER: `run`, `plan` and `export` themselves, once each. What a kill leaves is what is in
the folder at that moment, as the system keeps it: before every operation the folder is copied, and the copy is recovered.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import shutil
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from uvms_ocp.errors import OutputError
from uvms_ocp.record.manifest import Manifest, is_same
from uvms_ocp.record.output import RUNNING, Replacement, claim_folder, recover_folder

CHANGING = {"open", "os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.link"}
FOREIGN = {"mine.txt": "mine", "figures/mine.png": "mine"}
OLD = {
    "report.json": "old",
    "record.npz": "old",
    "plan.csv": "old",
    "figures/a.png": "old",
    "gone/b.png": "old",
}
NEW = {
    "report.json": "new",
    "record.npz": "new",
    "figures/a.png": "new",
    "figures/c.png": "new",
    "made/d.png": "new",
}
COMMANDS = {
    "run": ["run", "--plant", "kinematic", "--duration", "0.1", "--force"],
    "plan": ["plan", "curve", "--robot", "planar5", "--joint", "x0=0.5"],
    "export": ["export", "controller", "reach", "--plant", "kinematic"],
}
State = dict[str, str]


class Watch:
    """Calls `act` with the number and the kind of every operation in `root` that changes files."""

    def __init__(self) -> None:
        self.root = ""
        self.n = 0
        self.act = lambda n, event: None
        self.watching = False
        sys.addaudithook(self._hear)
        os.fsync = self._sync  # which kills need not wait for

    @contextmanager
    def on(self, root: Path, act: Callable[[int, str], None]) -> Iterator[None]:
        self.root = str(root)
        self.n = 0
        self.act = act
        self.watching = True
        try:
            yield
        finally:
            self.watching = False

    def _hear(self, event: str, arguments: tuple[Any, ...]) -> None:
        if self.watching and event in CHANGING:
            path = (
                os.fspath(arguments[0])
                if isinstance(arguments[0], (str, bytes, os.PathLike))
                else ""
            )
            if not os.path.isabs(path) or str(path).startswith(
                self.root
            ):  # what is removed from trees is relative
                self._tell(
                    "reading"
                    if event == "open" and not arguments[2] & (os.O_WRONLY | os.O_RDWR)
                    else event
                )

    def _sync(self, descriptor: int) -> None:
        if self.watching:
            self._tell("os.fsync")

    def _tell(self, event: str) -> None:
        self.n += 1
        self.act(self.n, event)


WATCH = Watch()


def write(folder: Path, contents: State) -> None:
    with claim_folder(folder, contents) as claim, claim.staged() as staging:
        fill(staging, contents)


def fill(folder: Path, contents: State) -> None:
    for name, text in contents.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)


def state(folder: Path) -> State:
    """Every file with its contents, but of the store only that nothing is left over in it."""
    store_files = {".uvms_ocp/lock", ".uvms_ocp/manifest.json"}
    running = f"{RUNNING}/"  # rows of a run that goes on, which are there beside all else
    files = {
        path.relative_to(folder).as_posix(): path for path in folder.rglob("*") if path.is_file()
    }
    return {
        name: hashlib.sha256(path.read_bytes()).hexdigest()
        for name, path in files.items()
        if name not in store_files and not name.startswith(running)
    }


def recovered(folder: Path) -> State:
    recover_folder(folder)
    return state(folder)


def name_of(files: State, states: dict[str, State]) -> str:
    return next(
        (name for name, known_files in states.items() if files == known_files),
        f"neither: {sorted(files)}",
    )


def prepared(folder: Path, old: State) -> Path:
    """Files of ours and of others."""
    write(folder, old)
    fill(folder, FOREIGN)
    return folder


def small_states(folder: Path) -> tuple[Path, dict[str, State]]:
    before = prepared(folder / "before", OLD)
    fresh = shutil.copytree(before, folder / "after")
    write(fresh, NEW)
    return before, {"old": state(before), "new": state(fresh)}


def in_child(work: Callable[[], None]) -> bool:
    """Whether it was killed."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            work()
            code = 0
        finally:
            os._exit(code)
    status = os.waitpid(child, 0)[1]
    assert os.WIFSIGNALED(status) or os.WEXITSTATUS(status) == 0
    return os.WIFSIGNALED(status)


def kill_at(k: int) -> Callable[[int, str], None]:
    return lambda n, event: os.kill(os.getpid(), signal.SIGKILL) if n == k else None


def killed_at(folder: Path, k: int, work: Callable[[], None]) -> bool:
    def watched() -> None:
        with WATCH.on(folder, kill_at(k)):
            work()

    return in_child(watched)


def killed(folder: Path) -> Any:
    """A kill at every operation, and at every operation of the recovery from it."""
    before, states = small_states(folder)
    recovered_states = []
    twice_recovered_states = []
    k = 1
    while killed_at(work := copy_of(before, folder / "work"), k, lambda: write(work, NEW)):
        after_kill = copy_of(work, folder / "left")
        j = 1
        while k % 9 == 0 and killed_at(
            second_copy := copy_of(after_kill, folder / "second"),
            j,
            lambda: recover_folder(second_copy),
        ):
            twice_recovered_states.append(name_of(recovered(second_copy), states))
            j += 1
        recovered_states.append(name_of(recovered(work), states))
        write(work, NEW)
        assert state(work) == states["new"]
        k += 1
    return {"found": recovered_states, "again": twice_recovered_states}


def copy_of(folder: Path, target: Path) -> Path:
    shutil.rmtree(target, ignore_errors=True)
    return shutil.copytree(folder, target)


def refused_at(k: int, *, stays: bool) -> Callable[[int, str], None]:
    """The disk is full at operation k; if that stays, everything that takes room fails from then
    on.
    """

    def act(n: int, event: str) -> None:
        if n == k or (stays and n > k and event in ("open", "os.mkdir", "os.link", "os.fsync")):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    return act


def refused(folder: Path, *, stays: bool) -> Any:
    """What is there after the disk refused operation k, before any recovery, and what was said."""
    before, states = small_states(folder)
    outcomes = []
    k = 1
    while k == 1 or k - 1 <= WATCH.n:  # until no operation k is left
        work = copy_of(before, folder / "work")
        message = None
        try:
            with WATCH.on(work, refused_at(k, stays=stays)):
                write(work, NEW)
        except OutputError as error:
            message = str(error)
        files_before_recovery = {
            name: text for name, text in state(work).items() if not name.startswith(".uvms_ocp/")
        }
        outcomes.append(
            (name_of(files_before_recovery, states), name_of(recovered(work), states), message)
        )
        k += 1
    return outcomes


def commands(folder: Path) -> Any:
    os.cpu_count = lambda: (
        1
    )  # a copy of this process beside it would be out of the watch's sight, and not wait for it
    return {name: command(folder / name, arguments) for name, arguments in COMMANDS.items()}


def command(folder: Path, arguments: list[str]) -> Any:
    """The states recovered from before every operation, and what is left by a kill between the
    moves of another call.

    The other call writes other times of computation, so its files are known by the manifest alone.
    """
    from uvms_ocp.cli.commands import app

    written = {
        "report.json": "old",
        "controller.h": "old",
        "scene.html": "old",
        "figures/path.png": "old",
    }
    target = prepared(folder, written)
    old = state(target)
    recovered_states = []

    def copy_and_recover(n: int, event: str) -> None:
        WATCH.watching = False
        recovered_states.append(recovered(copy_of(target, folder.with_suffix(".copy"))))
        WATCH.watching = True

    place = [str(target)] if arguments[0] == "export" else ["--out", str(target)]
    with WATCH.on(target, copy_and_recover):
        app([*arguments, *place], standalone_mode=False)
    new = state(target)
    moves = []
    known_states = {"old": old, "new": new}
    if arguments[0] != "export":  # what is safe before anything is drawn of it
        drawn = [name for name in new if name.startswith("figures/") or name == "scene.html"]
        safe_names = {"record.npz"} if arguments[0] == "run" else new.keys() - drawn
        known_states["record"] = {name: new[name] for name in safe_names.union(FOREIGN)}

    def kill(n: int, event: str) -> None:
        moves.extend([n] if event == "os.link" else [])
        if len(moves) == 3:
            os.kill(os.getpid(), signal.SIGKILL)

    def again() -> None:
        with WATCH.on(target, kill):
            app([*arguments, *place], standalone_mode=False)

    return {
        "found": [name_of(recovered_state, known_states) for recovered_state in recovered_states],
        "killed": in_child(again),
        "is_mixed": (target / ".uvms_ocp" / "journal.json").exists(),
        "left": sorted(recovered(target)),
        "as_in_manifest": all(
            is_same(target / name, digest) for name, digest in manifest_in(target).files.items()
        ),
        "files": sorted([*manifest_in(target).files, *FOREIGN]),
    }


def manifest_in(folder: Path) -> Manifest:
    return Replacement(target=folder).manifest()


if __name__ == "__main__":
    root_folder = Path(sys.argv[2]).resolve()
    answers = {
        "killed": lambda: killed(root_folder),
        "refused": lambda: refused(root_folder, stays=False),
        "full": lambda: refused(root_folder, stays=True),
        "commands": lambda: commands(root_folder),
    }[sys.argv[1]]
    answer = answers()
    sys.stdout.write("\n" + json.dumps(answer) + "\n")
