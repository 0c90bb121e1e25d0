"""The order of tasks: priority is position in a tuple."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput, require_known
from uvms_ocp.record.display import SmallTable, TableDisplay
from uvms_ocp.tasks.task import Task


@checked
class Hierarchy(TableDisplay):
    """Tasks from the highest priority to the lowest.

    Without `order` the classes decide (`TaskClass`), ties keep the given order. `order` names every
    task once, highest first, and overrides the classes. Raises `InvalidInput` for what is not a
    task, duplicate names or an incomplete order, and `NameNotFound` for a name in it that no task
    has.
    """

    __slots__ = ("tasks",)

    def __init__(self, tasks: Sequence[Task], order: Sequence[str] | None = None) -> None:
        for task in tasks:
            if not isinstance(task, Task):
                raise InvalidInput(
                    f"{task!r} is not a task; give values such as HorizontalAttitude()"
                )
        counts = Counter(task.name for task in tasks)
        duplicates = sorted(name for name in counts if counts[name] > 1)
        if duplicates:
            raise InvalidInput(
                f"tasks share the name {', '.join(duplicates)}; give each its own `name`"
            )
        if order is None:
            self.tasks = tuple(sorted(tasks, key=lambda task: task.task_class))
        else:
            self.tasks = _ordered(tasks, order)

    def _table(self) -> SmallTable:
        rows = list[tuple[str, ...]]()
        for place, task in enumerate(self.tasks, start=1):
            rows.append((str(place), task.name, task.label, type(task).__name__))
        return SmallTable(
            title="Hierarchy, highest priority first",
            head=("", "task", "type", "class"),
            rows=tuple(rows),
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Task names, highest priority first."""
        return tuple(task.name for task in self.tasks)

    def index(self, name: str) -> int:
        """Return the position of the task `name`; raises `NameNotFound`."""
        require_known("task", name, self.names)
        return self.names.index(name)


def _ordered(tasks: Sequence[Task], order: Sequence[str]) -> tuple[Task, ...]:
    """Put tasks in an order of their names; raises as `Hierarchy` does."""
    by_name = {task.name: task for task in tasks}
    for name in order:
        require_known("task", name, by_name)
    if sorted(order) != sorted(by_name):
        raise InvalidInput(f"order {tuple(order)} must name each of {tuple(by_name)} once")
    return tuple(by_name[name] for name in order)
