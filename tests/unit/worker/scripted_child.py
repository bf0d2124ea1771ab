"""A job process for the tests of the runner: it renders nothing, and does what the file `script` of the data says."""

import os
import signal

from scene_attack_service.jobs.processes import connect, reply, requests
from scene_attack_service.settings import Settings

if __name__ == "__main__":
    connection = connect()
    abilities = {"device": "cpu", "targets": ["efficientnet-lite0"], "memory": 7}
    reply(connection, {"ready": os.getpid(), "abilities": abilities})
    for message in requests(connection):
        script = (Settings().data_dir / "script").read_text()
        if script == "die":
            os.kill(os.getpid(), signal.SIGKILL)
        if script == "hang":
            signal.pause()
        reply(connection, {"outage": "the disk is full"} if script == "outage" else {"done": message["job"]})
