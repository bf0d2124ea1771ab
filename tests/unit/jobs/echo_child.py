"""A child process for the tests of children: answers, is silent, or dies, as asked."""

import mmap
import os
import signal

from scene_attack_service.jobs.processes import OUT_OF_MEMORY, connect, reply, requests

if __name__ == "__main__":
    connection = connect()
    reply(connection, {"ready": os.getpid(), "allocator": os.environ["MALLOC_TOP_PAD_"]})
    for message in requests(connection):
        if message == {"do": "die"}:
            os.kill(os.getpid(), signal.SIGKILL)
        if message == {"do": "hang"}:
            signal.pause()
        if message == {"do": "fill"}:
            shared = mmap.mmap(-1, 2**26)
            shared.write(bytes(2**26))
            signal.pause()
        if message == {"do": "give up"}:
            reply(connection, OUT_OF_MEMORY)
            continue
        if message == {"do": "stop"}:
            os.kill(os.getpid(), signal.SIGSTOP)
        reply(connection, {"message": message})
