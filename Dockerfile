# Three images from one file:
#   api          HTTP service and set-up; no numerical stack
#   worker       training, rollouts and videos on the CPU, drawn in software; the reconciler
#   worker-cuda  the same on NVIDIA GPUs, one worker each, drawn by EGL
# `docker compose build` makes api and worker; docs/install.md says what is in them and how large they are.

ARG PYTHON=3.12-slim-bookworm

# ---- what every image stands on ------------------------------------------------------------------

FROM python:${PYTHON} AS base
RUN apt-get update \
    && apt-get install -y --no-install-recommends tini \
    && apt-get clean && rm -rf /var/lib/apt/lists/* /var/cache/apt/*.bin \
    && groupadd --gid 10001 gaitway \
    && useradd --uid 10001 --gid gaitway --home-dir /tmp --no-create-home gaitway \
    # New volumes take their owner from these folders.
    && install -d -o gaitway -g gaitway -m 700 /run/gaitway /var/lib/gaitway /volumes/objects \
    && install -d -o gaitway -g gaitway -m 755 /volumes/database-password \
    # The user of the image postgres.
    && install -d -o 999 -g 999 -m 700 /volumes/postgres
ENV PATH=/opt/gaitway/bin:$PATH \
    PYTHONSAFEPATH=1 \
    PYTHONUNBUFFERED=1 \
    PYTHONDONTWRITEBYTECODE=1
WORKDIR /tmp
# It reaps what outlives its parent, and hands signals on to the one process below it.
ENTRYPOINT ["tini", "--"]

FROM base AS drawing
RUN apt-get update \
    && apt-get install -y --no-install-recommends libegl1 libgl1-mesa-dri libopengl0 \
    && apt-get clean && rm -rf /var/lib/apt/lists/* /var/cache/apt/*.bin

# ---- what is installed, from the lock file -------------------------------------------------------

FROM python:${PYTHON} AS build
RUN python -m pip install --no-cache-dir --disable-pip-version-check uv==0.9.30 hatchling==1.28.0
ENV UV_CACHE_DIR=/var/cache/uv \
    UV_COMPILE_BYTECODE=1 \
    UV_LINK_MODE=copy \
    UV_PYTHON_DOWNLOADS=never \
    UV_PROJECT_ENVIRONMENT=/opt/gaitway
WORKDIR /source

FROM build AS dependencies
RUN apt-get update \
    && apt-get install -y --no-install-recommends binutils \
    && apt-get clean && rm -rf /var/lib/apt/lists/* /var/cache/apt/*.bin
COPY pyproject.toml uv.lock ./
# What nobody imports here: other packages' tests and their data, MuJoCo's studio for the browser, the pitch and the
# players of dm_control's football, what its fly was built from, and an arm of mjlab's. And names for debuggers, a
# third of jaxlib; what auditwheel has rewritten (*.libs) and what runs on GPUs stays as it is.
RUN python -m uv venv /opt/gaitway \
    && printf '%s\n' '#!/bin/sh' \
    "find /opt/gaitway/lib -type d '(' -name tests -o -name SelfTest -o -path '*/mjx/test_data' \\" \
    "    -o -path '*/mujoco/experimental/studio' -o -path '*/dm_control/mujoco/testing' \\" \
    "    -o -path '*/locomotion/soccer' -o -path '*/assets/build_fruitfly' -o -path '*/onnx/backend/test' \\" \
    "    -o -path '*/robots/i2rt_yam' ')' -prune -exec rm -r {} +" \
    "find /opt/gaitway/lib -name '*.so' -not -path '*.libs/*' -not -path '*/jax_plugins/*' \\" \
    "    -not -path '*/nvidia/*' -exec strip --strip-unneeded {} +" > /usr/local/bin/slim \
    && chmod +x /usr/local/bin/slim

FROM dependencies AS dependencies-api
RUN --mount=type=cache,target=/var/cache/uv \
    python -m uv sync --frozen --no-install-project --no-default-groups --extra api --extra cli --extra news

FROM dependencies AS dependencies-worker
RUN --mount=type=cache,target=/var/cache/uv \
    python -m uv sync --frozen --no-install-project --no-default-groups \
    --extra worker --extra compiled --extra news --extra sweeps \
    --extra brittle-star --extra dm-control --extra playground --extra plots --extra wandb --extra cli \
    --group robots \
    && /usr/local/bin/slim

FROM dependencies AS dependencies-worker-cuda
RUN --mount=type=cache,target=/var/cache/uv \
    python -m uv sync --frozen --no-install-project --no-default-groups \
    --extra worker --extra compiled --extra cuda --extra warp \
    --extra brittle-star --extra dm-control --extra playground --extra plots --extra wandb --extra cli \
    --group robots \
    && /usr/local/bin/slim

# Apart from the dependencies, so that a change of code makes this small layer anew and nothing else.
FROM build AS project
RUN python -m uv venv /opt/gaitway
WORKDIR /opt/gaitway/source
COPY . .
# Editable, as in a clone: the usual wheel has the service's packages aside.
RUN python -m hatchling build -t wheel:editable -d /tmp/wheel \
    && python -m uv pip install --python /opt/gaitway/bin/python --no-deps /tmp/wheel/*.whl \
    && chmod -R a+rX . \
    && python -m compileall -q api core gaitway mujoco_compiled worker

# ---- the images ----------------------------------------------------------------------------------

FROM base AS api
COPY --from=dependencies-api /opt/gaitway /opt/gaitway
COPY --from=project /opt/gaitway /opt/gaitway
USER gaitway
EXPOSE 8000
CMD ["python", "-m", "api", "--host", "0.0.0.0", "--port", "8000"]
HEALTHCHECK --interval=10s --timeout=5s --start-period=20s \
    CMD ["python", "-c", "from urllib.request import urlopen; urlopen('http://127.0.0.1:8000/readyz', timeout=4)"]
LABEL org.opencontainers.image.title="Gaitway API" \
      org.opencontainers.image.description="The HTTP service of Gaitway" \
      org.opencontainers.image.source="https://github.com/gaitway/gaitway" \
      org.opencontainers.image.licenses="Apache-2.0"

FROM drawing AS worker
ENV GAITWAY_DATA_DIR=/var/lib/gaitway \
    GAITWAY_ALIVE_FILE=/tmp/gaitway-alive \
    GAITWAY_DEVICE=cpu \
    XDG_CACHE_HOME=/var/lib/gaitway/cache
COPY --from=dependencies-worker /opt/gaitway /opt/gaitway
COPY --from=project /opt/gaitway /opt/gaitway
USER gaitway
VOLUME /var/lib/gaitway
CMD ["python", "-m", "worker.main"]
HEALTHCHECK --interval=15s --timeout=5s --start-period=30s CMD ["python", "-m", "worker.host.health"]
LABEL org.opencontainers.image.title="Gaitway worker" \
      org.opencontainers.image.description="Training, rollouts and videos on the CPU" \
      org.opencontainers.image.source="https://github.com/gaitway/gaitway" \
      org.opencontainers.image.licenses="Apache-2.0"

FROM drawing AS worker-cuda
# The NVIDIA runtime brings the driver's libraries, those for graphics only where they are asked for, and
# not always the file by which EGL finds its driver among several.
RUN install -d /usr/share/glvnd/egl_vendor.d \
    && echo '{"file_format_version": "1.0.0", "ICD": {"library_path": "libEGL_nvidia.so.0"}}' \
    > /usr/share/glvnd/egl_vendor.d/10_nvidia.json
ENV GAITWAY_DATA_DIR=/var/lib/gaitway \
    GAITWAY_ALIVE_FILE=/tmp/gaitway-alive \
    GAITWAY_DEVICE=gpu \
    XDG_CACHE_HOME=/var/lib/gaitway/cache \
    CUDA_CACHE_PATH=/var/lib/gaitway/cache/cuda \
    WARP_CACHE_PATH=/var/lib/gaitway/cache/warp \
    NVIDIA_VISIBLE_DEVICES=all \
    NVIDIA_DRIVER_CAPABILITIES=compute,utility,graphics
COPY --from=dependencies-worker-cuda /opt/gaitway /opt/gaitway
COPY --from=project /opt/gaitway /opt/gaitway
USER gaitway
VOLUME /var/lib/gaitway
CMD ["python", "-m", "worker.fleet"]
HEALTHCHECK --interval=15s --timeout=5s --start-period=60s CMD ["python", "-m", "worker.host.health"]
LABEL org.opencontainers.image.title="Gaitway worker for NVIDIA GPUs" \
      org.opencontainers.image.description="Training, rollouts and videos, one worker for each GPU" \
      org.opencontainers.image.source="https://github.com/gaitway/gaitway" \
      org.opencontainers.image.licenses="Apache-2.0"
