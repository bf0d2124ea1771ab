"""What a service bears, each part with a service of its own. Writes results/load.json.

posts: jobs submitted through the API, eight requests at a time, while one worker runs them; then every id that was
answered is looked for in the list. reads: requests that begin at fixed moments, so that one that is late counts from
when it should have begun, while two workers with a thread each run jobs; two in three ask for a job, one for the first
50 jobs, and the time is that until the whole answer is read. streams: event streams of one running job, and the memory
of the process that serves them.

The client runs on the same machine and takes its share of it: that of the reads is aiohttp, which takes a quarter of
the time that httpx does. The machine should be idle.
"""

import argparse
import asyncio
import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median, quantiles
from typing import Any

import aiohttp
import httpx

from benchmarks.chaos.client import Client
from benchmarks.chaos.jobs import mixed
from benchmarks.chaos.service import Service
from benchmarks.report import RESULTS, save
from services.settings import Settings

AT_ONCE = 8
"""Submissions in flight."""
READERS = 32
"""Connections that read."""
LONG = 10_000
"""Steps of a job that runs for minutes."""
LISTED = 200
"""Jobs in the record while it is read."""
WATCHDOG = 60.0
MIB = 2**20


def main() -> None:
    """Runs the parts; see --help."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--posts", type=int, default=10_000, help="jobs to submit (default 10000; 0: leave out)")
    parser.add_argument("--rate", type=int, default=300, help="reads a second (default 300; 0: leave out)")
    parser.add_argument("--seconds", type=float, default=30.0, help="how long to read (default 30)")
    parser.add_argument("--streams", type=int, default=500, help="event streams (default 500; 0: leave out)")
    parser.add_argument("--database-url", help="a PostgreSQL to use instead of SQLite; its database must be empty")
    parser.add_argument("--out", type=Path, default=RESULTS / "load.json")
    options = parser.parse_args()
    url = options.database_url
    found: dict[str, Any] = {"cores": os.cpu_count(), "load average before": os.getloadavg()[0]}
    if options.posts:
        with _served(url, workers=1, max_queued=options.posts + LISTED) as service:
            found["posts"] = asyncio.run(_posts(service, options.posts))
    if options.rate:
        with _served(url, workers=2) as service:
            found["reads"] = asyncio.run(_reads(service, options.rate, options.seconds))
    if options.streams:
        with _served(url, workers=1) as service:
            found["streams"] = asyncio.run(_streams(service, options.streams))
    save(options.out, __doc__ or "", "PostgreSQL" if url else "SQLite", 0, **found)


@contextmanager
def _served(database_url: str | None, **settings: Any) -> Iterator[Service]:
    os.sync()  # what was written before is no part of what follows
    with tempfile.TemporaryDirectory(prefix="scene-attack-load-") as folder:
        values = Settings(data=Path(folder) / "data", database_url=database_url, threads=1, **settings)
        service = Service(values, Path(folder) / "log", WATCHDOG)
        try:
            yield service
        finally:
            service.end()


def _busy(service: Service, workers: int) -> list[str]:
    """Gives each worker a job that it does not end, and returns their ids once all take steps."""
    client = Client(service.url, 120.0)
    try:
        ids = [client.submit(mixed(LONG)[1] | {"seed": number}, f"busy-{number}") for number in range(workers)]
        while any((client.job(one)["progress"] or {}).get("step", 0) < 1 for one in ids):
            time.sleep(0.1)
    finally:
        client.close()
    return ids


async def _posts(service: Service, count: int) -> dict[str, Any]:
    await asyncio.to_thread(_busy, service, 1)
    [request] = mixed(4)[:1]
    numbers, seconds, ids = iter(range(count)), list[float](), list[str]()
    async with httpx.AsyncClient(base_url=service.url, timeout=60, trust_env=False) as http:

        async def submit() -> None:
            for number in numbers:
                began = time.perf_counter()
                answer = await http.post("/v1/jobs", json=request | {"seed": number})
                seconds.append(time.perf_counter() - began)
                ids.append(answer.raise_for_status().json()["id"])

        began = time.perf_counter()
        await asyncio.gather(*(submit() for _ in range(AT_ONCE)))
        took = time.perf_counter() - began
        listed = await _listed(http)
    return {
        "jobs": count,
        "lost": len(set(ids) - listed),
        "a second": round(count / took, 1),
        "milliseconds": _spread(seconds),
    }


async def _listed(http: httpx.AsyncClient) -> set[str]:
    found: set[str] = set()
    query: dict[str, Any] = {"limit": LISTED}
    while True:
        page = (await http.get("/v1/jobs", params=query)).raise_for_status().json()
        found |= {item["id"] for item in page["items"]}
        if page.get("next") is None:
            return found
        query["cursor"] = page["next"]


async def _reads(service: Service, rate: int, seconds: float) -> dict[str, Any]:
    running = await asyncio.to_thread(_busy, service, 2)
    taken = list[float]()
    async with httpx.AsyncClient(base_url=service.url, timeout=60, trust_env=False) as http:
        for number in range(LISTED):
            (await http.post("/v1/jobs", json=mixed(4)[0] | {"seed": number})).raise_for_status()
    async with aiohttp.ClientSession(service.url, connector=aiohttp.TCPConnector(limit=READERS)) as quick:
        began, numbers = time.perf_counter() + 1, iter(range(round(rate * seconds)))

        async def read() -> None:
            for number in numbers:
                due = began + number / rate
                await asyncio.sleep(due - time.perf_counter())
                path = "/v1/jobs?limit=50" if number % 3 == 0 else f"/v1/jobs/{running[number % 2]}"
                async with quick.get(path, raise_for_status=True) as answer:
                    await answer.read()
                taken.append(time.perf_counter() - due)

        await asyncio.gather(*(read() for _ in range(READERS)))
        took = time.perf_counter() - began
    return {"a second": round(len(taken) / took, 1), "milliseconds": _spread(taken)}


async def _streams(service: Service, count: int) -> dict[str, Any]:
    [job] = await asyncio.to_thread(_busy, service, 1)
    before = _memory(service)
    limits = httpx.Limits(max_connections=None)
    opened = asyncio.Semaphore(0)
    async with httpx.AsyncClient(base_url=service.url, timeout=None, limits=limits, trust_env=False) as http:

        async def follow() -> None:
            async with http.stream("GET", f"/v1/jobs/{job}/events") as answer:
                answer.raise_for_status()
                first = True
                async for _ in answer.aiter_lines():
                    if first:
                        opened.release()
                        first = False

        streams = [asyncio.create_task(follow()) for _ in range(count)]
        for _ in range(count):
            await opened.acquire()
        await asyncio.sleep(5)
        after = _memory(service)
        for stream in streams:
            stream.cancel()
        await asyncio.gather(*streams, return_exceptions=True)
    return {"streams": count, "MiB before": round(before), "MiB": round(after)}


def _memory(service: Service) -> float:
    return float(sum(one.memory_info().rss for one in service.processes("api.main")) / MIB)


def _spread(seconds: list[float]) -> dict[str, float]:
    """Median, 99th percentile and largest, in milliseconds."""
    found = {"median": median(seconds), "99th percentile": quantiles(seconds, n=100)[-1], "largest": max(seconds)}
    return {name: round(1000 * value, 1) for name, value in found.items()}


if __name__ == "__main__":
    main()
