# The API and the workers are this one image, started as `scene-attack api` and `scene-attack worker`. It is made in two
# stages: the first has a compiler and whatever installing takes, the second is what runs.
FROM debian:12-slim AS build

RUN apt-get update \
    && apt-get install -y --no-install-recommends python3 python3-venv ca-certificates g++ libosmesa6 libegl1 libgl1 libgl1-mesa-dri \
    && rm -rf /var/lib/apt/lists/*

WORKDIR /app
# Packages change seldom: they are a layer of their own.
COPY requirements.txt requirements-torch.txt pyproject.toml README.md LICENSE NOTICE ./
COPY scripts/setup scripts/
COPY services/scene_attack/__init__.py services/scene_attack/
COPY services/scene_attack_service/__init__.py services/scene_attack_service/
COPY services/scene_attack_questions/__init__.py services/scene_attack_questions/
COPY services/scene_attack_accuracy/__init__.py services/scene_attack_accuracy/
COPY api/scene_attack_api/__init__.py api/scene_attack_api/
COPY worker/scene_attack_worker/__init__.py worker/scene_attack_worker/
RUN scripts/setup
# The kernels, for other machines than the one that builds. They lie outside of the cache, which is a volume: a new image
# brings its own.
COPY services services
COPY api api
COPY worker worker
ENV SCENE_ATTACK_CACHE=/assets \
    SCENE_ATTACK_KERNEL_ARCH=portable \
    SCENE_ATTACK_KERNEL_DIR=/kernels
RUN .venv/bin/python -m scene_attack assets fetch && chmod -R a+rX /assets
RUN .venv/bin/python -m scene_attack.rendering.kernels.build

FROM debian:12-slim AS production

RUN apt-get update \
    && apt-get install -y --no-install-recommends python3 ca-certificates libgomp1 libosmesa6 libegl1 libgl1 libgl1-mesa-dri \
    && rm -rf /var/lib/apt/lists/*

RUN useradd --system --create-home --uid 10001 scene-attack \
    && mkdir /data && chown scene-attack /data

WORKDIR /app
COPY --from=build --chown=scene-attack /assets /assets
COPY --from=build /app/.venv .venv
COPY --from=build /kernels /kernels
COPY pyproject.toml README.md ./
COPY services services
COPY api api
COPY worker worker

ENV PATH=/app/.venv/bin:$PATH \
    PYTHONDONTWRITEBYTECODE=1 \
    SCENE_ATTACK_CACHE=/assets \
    SCENE_ATTACK_DATA=/data \
    SCENE_ATTACK_KERNEL_ARCH=portable \
    SCENE_ATTACK_KERNEL_DIR=/kernels
USER scene-attack
EXPOSE 8008
# Needs a key first, which is in the database: docker run --rm -v data:/data IMAGE scene-attack keys create me --scope admin
CMD ["scene-attack", "serve", "--host", "0.0.0.0"]
