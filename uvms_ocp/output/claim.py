"""A folder for the results of one command: checked and locked before the work, replaced whole after it."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from uvms_ocp.arguments import checked
from uvms_ocp.exceptions import OutputError, UvmsError
from uvms_ocp.output.durable import discard, remove_empty
from uvms_ocp.output.foreign import require_ours
from uvms_ocp.output.journal import Replacement
from uvms_ocp.output.lock import locked


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Claim:
    """A folder that only this command writes to until it ends."""

    replacement: Replacement

    @contextmanager
    def staged(self) -> Iterator[Path]:
        """Give an empty folder; the files written there then take the place of all earlier ones of ours.

        On any error the folder is as before. Raises `OutputError` where the disk refuses, and `InvalidInput` for what has
        come to stand in the way.
        """
        replacement = self.replacement
        try:
            with in_one_line(replacement.target):
                replacement.new.mkdir()
                yield replacement.new
                replacement.commit()
        except BaseException:
            if not replacement.is_begun():
                discard(replacement.new)
            raise

    def written(self) -> list[Path]:
        """The files of ours that are there. Raises `InvalidInput` for a damaged manifest."""
        return [self.replacement.target / name for name in sorted(self.replacement.manifest().files)]


@contextmanager
def claimed(target: Path, names: Collection[str]) -> Iterator[Claim]:
    """The folder `target` for one command that may write files of these `names`, such as ``figures/path.png``.

    Completes or undoes first what a command that was cut off left. Raises `InvalidInput` for what stands in the way, and
    `OutputError` where the folder cannot be written or another command is at it: before the work begins.
    """
    replacement = Replacement(target=target)
    with ExitStack() as stack:
        with in_one_line(target):
            stack.callback(remove_empty, [folder for folder in (target, *target.parents) if not folder.exists()])
            target.mkdir(parents=True, exist_ok=True)
            stack.enter_context(locked(replacement.store))
            replacement.recover()
            require_ours(target, names, replacement.manifest())
        yield Claim(replacement=replacement)


@checked
def settle(folder: Path) -> None:
    """Before `folder` is read: complete or undo what a command that was cut off left there.

    Raises `OutputError` where that cannot be done, or is being done, and `InvalidInput` for what stands in the way.
    """
    replacement = Replacement(target=folder)
    if not replacement.is_left_over():
        return
    try:
        with in_one_line(folder), locked(replacement.store):
            replacement.recover()
    except OutputError:
        # New files that wait beside complete old ones do not matter to a reader.
        if replacement.is_begun():
            raise


@contextmanager
def in_one_line(target: Path, advice: str = "choose another folder") -> Iterator[None]:
    """What the system refuses in the block is an `OutputError` of a file or folder; what is an error of ours stays as it is."""
    try:
        yield
    except UvmsError:
        raise
    except OSError as error:
        reason = error.strerror or " ".join(str(error).split())
        raise OutputError(f"{target}: cannot write there ({reason}); {advice}") from error
