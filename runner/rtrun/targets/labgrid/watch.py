"""Watch a place of a farm while it is ours: whether its exporter and its coordinator are still there."""

import contextlib
import threading
from collections.abc import Callable, Iterator

from rtfiles.errors import InfrastructureError
from rtrun.targets.labgrid.coordinator import LabgridClient, find_place, what_ended

WATCH_S = 10.0


@contextlib.contextmanager
def watching(client: LabgridClient, name: str, notify: Callable[[str], None], *, is_ours: bool) -> Iterator[None]:
    """While the context lasts, report once what is wrong with an acquired place, and once that it is right again.

    Measuring needs neither coordinator nor exporter, so it continues. A restarted coordinator does not know who had a
    place (labgrid 26). So a place that is ours is acquired again, unless the user had acquired it before: otherwise
    others might take it.
    """
    ended = threading.Event()

    def watch() -> None:
        reported = ""
        while not ended.wait(WATCH_S):
            wrong = ""
            try:
                wrong = _wrong(client, name, ended if is_ours else None)
            except InfrastructureError as error:
                wrong = str(error)
            if wrong != reported:
                notify(f"{wrong}; measuring goes on" if wrong else f"place {name} is as it was")
                reported = wrong

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield
    finally:
        ended.set()
        watcher.join()


def _wrong(client: LabgridClient, name: str, ended: threading.Event | None) -> str:
    """What is wrong with a place; empty: nothing. Acquires it again unless `ended` is set or None."""
    place = find_place(client.coordinator, name)
    if place is None:
        return f"the labgrid coordinator at {client.coordinator} has no place {name} any more"
    if ended_there := what_ended(client.coordinator, place):
        return ended_there
    if place.holder is None and ended is not None and not ended.is_set():
        client.call("-p", name, "acquire")
    elif place.holder not in (None, client.identity):
        return f"place {name} is held by {place.holder}, who took it from rtrun"
    return ""
