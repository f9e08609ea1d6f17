# torchrender in a container, from this checkout. The CPU:
#
#     docker build -t torchrender .
#     docker run --rm -it -v "$PWD:/work" torchrender torchrender render /opt/torchrender/scenes/cornell_box.xml -o box.png
#
# Beside a GPU, for whoever trains networks in the same process (torchrender itself computes on the CPU):
#
#     docker build -t torchrender-cuda --build-arg BASE=nvidia/cuda:13.0.1-runtime-ubuntu24.04 --build-arg TORCH_INDEX= .
#
# TORCH_INDEX: where torch is taken from; empty: PyPI, whose build for Linux has CUDA.
ARG BASE=python:3.13-slim-bookworm

FROM ${BASE} AS build
ENV DEBIAN_FRONTEND=noninteractive
RUN apt-get update && apt-get install -y --no-install-recommends g++ python3 python3-pip python3-venv \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /src
COPY pyproject.toml setup.py MANIFEST.in README.md LICENSE ./
COPY csrc csrc
COPY torchrender torchrender
# An environment, since the Pythons of Debian and Ubuntu take no packages of pip.
RUN python3 -m venv /build && /build/bin/pip wheel --no-cache-dir --no-deps -w /wheels .

FROM ${BASE}
ARG TORCH="torch==2.13.0"
ARG TORCH_INDEX=https://download.pytorch.org/whl/cpu
ENV DEBIAN_FRONTEND=noninteractive PATH=/opt/venv/bin:$PATH
RUN (command -v python3 && python3 -m venv --help > /dev/null && python3 -c "import ensurepip") \
    || (apt-get update && apt-get install -y --no-install-recommends python3 python3-venv && rm -rf /var/lib/apt/lists/*)
RUN --mount=type=bind,from=build,source=/wheels,target=/wheels \
    python3 -m venv /opt/venv \
    && pip install --no-cache-dir ${TORCH_INDEX:+--index-url "$TORCH_INDEX"} "$TORCH" \
    && pip install --no-cache-dir /wheels/*.whl
COPY scenes /opt/torchrender/scenes
COPY tutorials /opt/torchrender/tutorials
WORKDIR /work
CMD ["python", "-c", "import torchrender; torchrender.show_config()"]
