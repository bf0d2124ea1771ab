"""`python -m worker.deliveries`: sends the messages of the outbox to webhooks, several at a time, until it is ended."""

import signal
import threading
import time
from collections import Counter
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait

from sqlalchemy.exc import SQLAlchemyError

from services.jobs import watchdog
from services.jobs.database import connect
from services.jobs.webhook_sending import SECONDS, send
from services.jobs.webhooks import Message, Webhooks
from services.logs import bound, configure, logger
from services.settings import Settings

AT_ONCE = 32
PER_OWNER = 4
"""Messages of one owner that are sent at the same time: a receiver may take 15 seconds to say nothing."""
POLL_SECONDS = 1.0
SWEEP_SECONDS = 3600.0
AGAIN_SECONDS = 4 * SECONDS
"""Time after which a message is due again whose process died."""

log = logger(__name__)


class Sender:
    """Sends what is due. Used by one thread."""

    def __init__(self, webhooks: Webhooks, values: Settings, pool: Executor) -> None:
        self._webhooks = webhooks
        self._allowed = values.allowed_webhook_hosts
        self._pool = pool
        self._sending: dict[Future[None], str] = {}

    def round(self) -> None:
        """Begins to send messages that are due, and waits a moment until one has been sent.

        Raises SQLAlchemyError if the record of one that was sent could not be written; it is sent again.
        """
        busy = Counter(self._sending.values())
        for message in self._webhooks.take(AT_ONCE - len(self._sending), AGAIN_SECONDS, PER_OWNER, busy):
            self._sending[self._pool.submit(self._send, message)] = message.owner
        ended, _ = wait(self._sending, POLL_SECONDS, FIRST_COMPLETED)
        for one in ended:
            del self._sending[one]
        for one in ended:
            one.result()

    def idle(self) -> bool:
        """Whether nothing is being sent."""
        return not self._sending

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
    values = Settings()
    webhooks = Webhooks(connect(values))
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    watchdog.started()
    swept = float("-inf")
    with ThreadPoolExecutor(AT_ONCE) as pool:
        sender = Sender(webhooks, values, pool)
        while not stop.is_set():
            watchdog.alive()
            try:
                if time.monotonic() - swept > SWEEP_SECONDS:
                    swept = time.monotonic()
                    webhooks.sweep()
                sender.round()
            except SQLAlchemyError as error:
                log.warning("outbox out of reach", error=str(error))
                stop.wait(POLL_SECONDS)
            if sender.idle():
                stop.wait(POLL_SECONDS)


if __name__ == "__main__":
    main()
