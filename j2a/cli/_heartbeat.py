"""A board that hangs while its link stays open.

In: a client. Out: an error when nothing comes from the board any more.
Rule: a board whose sensors are quiet answers, so it is asked; only silence after that counts.
"""

from typing import Final

import j2a
from j2a.protocol.roster import Heartbeat

SILENT_S: Final = 3.0


class Pulse:
    """Looks whether anything comes from a board.

    Args:
        client: of the board.

    Attributes:
        heard_s: when something came last, as far as was seen, on the clock of the link.
    """

    def __init__(self, client: j2a.Client) -> None:
        self._client = client
        self._heartbeat = Heartbeat()
        self._listen()

    def _listen(self) -> None:
        self._heartbeat.begin(self._client.counters.frames_received)
        self.heard_s = self._client.now()

    def check(self) -> None:
        """Ask for an echo where nothing came for 3 s; call it each second or so.

        Raises:
            J2AError: the board hangs: it answered neither of two echoes; or the link is lost.
        """
        client = self._client
        if not client.is_open:
            client.call(0)  # raises what ended the link
        if not self._heartbeat.is_silent(client.counters.frames_received):
            self._listen()
        elif client.now() - self.heard_s >= SILENT_S:
            try:
                client.echo()
            except j2a.J2AError as error:
                if self._heartbeat.failed(error, is_open=client.is_open):
                    raise
                if isinstance(error, j2a.CallTimeout):
                    return  # it is asked again
            else:
                self._heartbeat.answered()
            self._listen()
