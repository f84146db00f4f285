"""The link to a target: reconnects when the connection breaks and notices when the target was restarted."""

import time
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Self, TypeVar

from rtfiles.untrusted import read_end
from rtrun.targets.config import Target
from rtrun.targets.connection import COMMAND_S, Completed, Connection
from rtrun.targets.errors import ConnectionLost, TargetError, TargetGone

RETRY_S = 0.5
CONNECT_S = 10.0  #: each of the four steps of a connection
# A booting emulated board accepts TCP connections long before its SSH server answers: give up early, try again.
CONNECT_BOOTING_S = 3.0  #: such a step of a board that boots
# Each try has more time than the last: a board on a busy host may need long for a handshake.
CONNECT_GROWTH = 1.5
CONNECT_MAX_S = 30.0  #: such a step after failures; it has more time with each try
BREAKS_MAX = 5  #: broken connections during one step of a run
# A console may have printed for days. Its last line is within this end.
CONSOLE_END_BYTES = 16 * 1024

T = TypeVar("T")


class Interrupted(KeyboardInterrupt):
    """Another thread, which received Ctrl-C, ends the work on a link."""


class TargetRebooted(TargetError):
    """The target came back with another boot id: what was running there has ended."""


# The target cannot be reached now. What runs there stays as it is.
OUT_OF_REACH = (ConnectionLost, TargetGone, TargetRebooted)


class Link:
    """Calls actions with a live `Connection`, and connects again when it is lost.

    An action may run again from its beginning, so it must be repeatable.
    """

    def __init__(self, target: Target, notify: Callable[[str], None]) -> None:
        self.target = target
        self.boot_id = ""
        self.note = notify
        self._connection: Connection | None = None
        self._given_up: TargetError | None = None
        self._is_interrupted = False
        self._expects_boot = False

    def __enter__(self) -> Self:
        self.do(lambda _: None)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.drop()

    def drop(self) -> None:
        """Close the connection; the next action makes a new one."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def interrupt(self) -> None:
        """Raise Interrupted, once, in the thread that uses this link. After that the thread can clean up."""
        self._is_interrupted = True
        if (connection := self._connection) is not None:
            connection.interrupt()

    def expect_boot(self) -> None:
        """Allow the target its boot time. Call this before its power is switched on purpose."""
        self._expects_boot = True

    def _check_interrupt(self) -> None:
        if self._is_interrupted:
            self._is_interrupted = False
            raise Interrupted("rtrun was interrupted")

    def do(self, action: Callable[[Connection], T]) -> T:
        """Run an action, reconnecting for as long as the target file allows.

        Raises TargetRebooted once after the target came back with another boot, TargetGone when it will not come back,
        ConnectionLost when the time is up or the connection has broken BREAKS_MAX times during this action, and
        whatever else the action raises.
        """
        breaks = 0
        while True:
            self._check_interrupt()
            if self._connection is None:
                self._connection = self._reconnect()
            try:
                return action(self._connection)
            except ConnectionLost as error:
                self.drop()
                self._check_interrupt()
                if failure := self.target.failure():
                    raise failure from error
                breaks += 1
                if breaks == BREAKS_MAX:
                    raise ConnectionLost(
                        f"{error}; this was the {breaks}th connection to break at the same step"
                    ) from error
                self.note(f"{error}; connecting again")

    def run(self, argv: Sequence[str], *, deadline_s: float = COMMAND_S, stdin: str = "") -> Completed:
        """`Connection.run` with a live connection. Raises as that and `do` do."""
        return self.do(lambda connection: connection.run(argv, deadline_s=deadline_s, stdin=stdin))

    def check(
        self,
        argv: Sequence[str],
        *,
        deadline_s: float = COMMAND_S,
        stdin: str = "",
        on_line: Callable[[str], None] | None = None,
    ) -> str:
        """`Connection.check` with a live connection. Raises as that and `do` do."""
        return self.do(lambda connection: connection.check(argv, deadline_s=deadline_s, stdin=stdin, on_line=on_line))

    def _reconnect(self) -> Connection:
        if self._given_up is not None:
            # Cleaning up after a failure must not wait a second time.
            raise self._given_up
        try:
            return self._connect()
        except TargetRebooted:
            raise
        except TargetError as error:
            self._given_up = error
            raise

    def _connect(self) -> Connection:
        first = not self.boot_id
        booting_s = self.target.power.boot_s if self._expects_boot and self.target.power else self.target.boot_s
        patience_s = self.target.boot_s if first else max(self.target.reconnect_s, booting_s)
        deadline = time.monotonic() + patience_s
        timeout_s = CONNECT_BOOTING_S if self.target.boot_s else CONNECT_S
        power, since = self.target.power, ""
        while True:
            try:
                return self._checked(Connection(self.target.address, timeout_s=timeout_s))
            except ConnectionLost as error:
                if failure := self.target.failure():
                    raise failure from error
                if time.monotonic() >= deadline and power is not None:
                    self.note(f"{error}; switching its power off and on")
                    power.cycle()
                    patience_s, since = power.boot_s, " since its power was switched off and on"
                    deadline, power = time.monotonic() + patience_s, None
                    continue
                if time.monotonic() >= deadline:
                    waited = f", tried for {patience_s:g} s{since}" if patience_s else ""
                    raise ConnectionLost(f"{error}{waited}{self._describe_console()}") from error
                time.sleep(RETRY_S)
                self._check_interrupt()
                timeout_s = min(timeout_s * CONNECT_GROWTH, CONNECT_MAX_S)

    def _checked(self, connection: Connection) -> Connection:
        """Return a new connection if the target is still in the same boot; raise TargetRebooted otherwise."""
        try:
            boot_id = connection.check_promptly(["cat", "/proc/sys/kernel/random/boot_id"]).strip()
        except BaseException:
            connection.close()
            raise
        before, self.boot_id = self.boot_id, boot_id
        if before and before != boot_id:
            self._expects_boot = False
            self._connection = connection
            raise TargetRebooted(f"{self.target.address}: the target was restarted (another boot id)")
        return connection

    def _describe_console(self) -> str:
        console = self.target.console
        if console is None or not console.exists():
            return ""
        end = read_end(console, max_bytes=CONSOLE_END_BYTES).decode(errors="replace")
        lines = end.strip().splitlines()
        return f"; its console ended with: {lines[-1]!r}" if lines else f"; its console {console} is empty"
