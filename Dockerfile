# The API and the workers are this one image, started as `scene-attack api` and `scene-attack worker`.
FROM debian:12-slim

RUN apt-get update \
    && apt-get install -y --no-install-recommends python3 python3-venv ca-certificates g++ libosmesa6 libegl1 libgl1 libgl1-mesa-dri \
    && rm -rf /var/lib/apt/lists/*

RUN useradd --system --create-home --uid 10001 scene-attack \
    && mkdir /data && chown scene-attack /data

WORKDIR /app
# Packages, meshes and environment maps change seldom: they are layers of their own.
COPY requirements.txt pyproject.toml README.md LICENSE NOTICE ./
COPY scripts/setup scripts/assets.sha256 scripts/
COPY services/__init__.py services/
COPY api/__init__.py api/
COPY worker/__init__.py worker/
COPY client/__init__.py client/
ENV SCENE_ATTACK_CACHE=/assets
RUN scripts/setup && chmod -R a+rX /assets && chown scene-attack /assets
COPY services services
COPY api api
COPY worker worker
COPY client client

ENV PATH=/app/.venv/bin:$PATH \
    PYTHONDONTWRITEBYTECODE=1 \
    SCENE_ATTACK_DATA=/data
USER scene-attack
EXPOSE 8008
CMD ["scene-attack", "serve", "--host", "0.0.0.0"]
