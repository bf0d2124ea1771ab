# The API and the workers are this one image, started as `scene-attack api` and `scene-attack worker`. It is made in two
# stages: the first has a compiler and whatever installing takes, the second is what runs.
FROM debian:12-slim AS build

RUN apt-get update \
    && apt-get install -y --no-install-recommends python3 python3-venv ca-certificates g++ libosmesa6 libegl1 libgl1 libgl1-mesa-dri \
    && rm -rf /var/lib/apt/lists/*

WORKDIR /app
# Packages change seldom: they are a layer of their own, and so are meshes and environment maps.
COPY requirements.txt requirements-torch.txt requirements-build.txt ./
COPY scripts/setup scripts/
RUN scripts/setup
COPY pyproject.toml README.md LICENSE NOTICE ./
COPY services services
COPY api api
COPY worker worker
# A wheel without kernels, which were not compiled, has another name.
RUN .venv/bin/python -m pip wheel --no-deps --no-build-isolation --wheel-dir /wheel . \
    && .venv/bin/python -m pip install --no-deps --no-index /wheel/scene_attack-*-linux_*.whl \
    && .venv/bin/python -m pip uninstall --yes -r requirements-build.txt
ENV SCENE_ATTACK_CACHE=/assets
RUN .venv/bin/scene-attack assets fetch && chmod -R a+rX /assets

FROM debian:12-slim AS production

RUN apt-get update \
    && apt-get install -y --no-install-recommends python3 ca-certificates libgomp1 libosmesa6 libegl1 libgl1 libgl1-mesa-dri \
    && rm -rf /var/lib/apt/lists/*

RUN useradd --system --create-home --uid 10001 scene-attack \
    && mkdir /data && chown scene-attack /data

WORKDIR /app
COPY --from=build --chown=scene-attack /assets /assets
COPY --from=build /app/.venv .venv

ENV PATH=/app/.venv/bin:$PATH \
    PYTHONDONTWRITEBYTECODE=1 \
    SCENE_ATTACK_CACHE=/assets \
    SCENE_ATTACK_DATA=/data
USER scene-attack
EXPOSE 8008
# Needs a key first, which is in the database: docker run --rm -v data:/data IMAGE scene-attack keys create me --scope admin
CMD ["scene-attack", "serve", "--host", "0.0.0.0"]
