"""The route for Prometheus."""

from fastapi import APIRouter, Request, Response
from prometheus_client.exposition import choose_encoder

router = APIRouter(tags=["service"])


@router.get("/metrics", response_class=Response, responses={200: {"content": {"text/plain": {}}}})
def get_metrics(request: Request) -> Response:
    """Reports metrics for Prometheus: the requests of this process, and the queue, jobs and workers of the service.

    Counters of jobs, steps, queries and stages are kept in the database: they are the same from every process, and
    never fall.
    """
    try:
        encode, media_type = choose_encoder(request.headers.get("accept", ""))
    except (TypeError, ValueError):  # a version that is none
        encode, media_type = choose_encoder("")
    return Response(encode(request.app.state.metrics.registry), media_type=media_type)
