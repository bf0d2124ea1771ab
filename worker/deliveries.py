"""`python -m worker.deliveries`: sends the messages of the outbox to webhooks, several at a time, until it is ended."""

import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor

from sqlalchemy.exc import SQLAlchemyError

from services.jobs import watchdog
from services.jobs.database import connect
from services.jobs.webhook_sending import SECONDS, send
from services.jobs.webhooks import Message, Webhooks
from services.logs import bound, configure, logger
from services.settings import Settings, settings

AT_ONCE = 8
POLL_SECONDS = 1.0
SWEEP_SECONDS = 3600.0
AGAIN_SECONDS = 4 * SECONDS
"""Time after which a message is due again whose process died."""

log = logger(__name__)


class Sender:
    """Sends what is due."""

    def __init__(self, webhooks: Webhooks, values: Settings) -> None:
        self._webhooks = webhooks
        self._allowed = values.allowed_webhook_hosts

    def round(self, pool: ThreadPoolExecutor) -> int:
        """Sends the messages that are due, at most one for each thread. Returns their number."""
        taken = self._webhooks.take(AT_ONCE, AGAIN_SECONDS)
        for _ in pool.map(self._send, taken):
            watchdog.alive()
        return len(taken)

    def _send(self, message: Message) -> None:
        with bound(message=message.id, attempt=message.attempt):
            status, error = send(message, self._allowed)
            self._webhooks.ended(message, status, error)
            if error is None:
                log.info("webhook told", status=status)
            else:
                log.warning("webhook not told", error=error)


def main() -> None:
    """Sends until SIGTERM or SIGINT."""
    configure("deliveries")
    values = settings()
    webhooks = Webhooks(connect(values))
    sender = Sender(webhooks, values)
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    watchdog.started()
    swept = float("-inf")
    with ThreadPoolExecutor(AT_ONCE) as pool:
        while not stop.is_set():
            watchdog.alive()
            try:
                if time.monotonic() - swept > SWEEP_SECONDS:
                    swept = time.monotonic()
                    webhooks.sweep()
                sent = sender.round(pool)
            except SQLAlchemyError as error:
                log.warning("outbox out of reach", error=str(error))
                sent = 0
            if not sent:
                stop.wait(POLL_SECONDS)


if __name__ == "__main__":
    main()
