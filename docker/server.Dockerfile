# The server beside the camera; as target "simulator", with the simulator that stands in for camera and robot.
# How to build and run: docs/containers.md

ARG BASE=docker.io/library/debian:bookworm-20260824-slim@sha256:88200866dfff7ea7f5cbcb6ec7c8a701889efe6fe859fe64d6990e4b07ea4171

# Debian's release pins the packages; what it has mended since the base image was made is wanted.
# hadolint global ignore=DL3008
FROM ${BASE} AS python
RUN apt-get update \
    && apt-get upgrade --yes \
    && apt-get install --yes --no-install-recommends python3 \
    && rm -rf /var/lib/apt/lists/* /var/cache/apt/* /var/log/apt /var/log/dpkg.log

FROM python AS build
RUN apt-get update \
    && apt-get install --yes --no-install-recommends python3-pip python3-venv \
    && rm -rf /var/lib/apt/lists/*
ENV PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_CONSTRAINT="/src/constraints.txt /src/accelerators.txt"
WORKDIR /src
COPY constraints.txt docker/accelerators.txt docker/requirements.py ./
COPY robot_client/pyproject.toml robot_client/
COPY server/pyproject.toml server/
COPY sim/pyproject.toml sim/
ARG ACCELERATOR=cpu
RUN python3 -m venv --without-pip /opt/revnm \
    && python3 requirements.py --accelerator "${ACCELERATOR}" robot_client server > server.txt \
    && python3 -m pip --python /opt/revnm/bin/python install --only-binary :all: --requirement server.txt

FROM build AS build-server
COPY robot_client robot_client
COPY server server
RUN python3 -m pip --python /opt/revnm/bin/python install --no-deps --prefix /packages ./robot_client ./server

FROM build AS build-simulator
COPY sim sim
RUN python3 requirements.py sim > simulator.txt \
    && python3 -m pip --python /opt/revnm/bin/python install --only-binary :all: --prefix /packages --requirement simulator.txt \
    && python3 -m pip --python /opt/revnm/bin/python install --no-deps --prefix /packages ./sim

FROM python AS server
RUN useradd --uid 10001 --home-dir /var/lib/revnm --create-home --shell /usr/sbin/nologin revnm
COPY --from=build /opt/revnm /opt/revnm
COPY --from=build-server /packages /opt/revnm
COPY LICENSE NOTICE /usr/share/doc/revnm/
# All that is written lies in the volume: compiled loops, state, calibrations, records.
ENV PATH=/opt/revnm/bin:$PATH PYTHONUNBUFFERED=1 NUMBA_CACHE_DIR=/var/lib/revnm/numba
WORKDIR /var/lib/revnm
VOLUME /var/lib/revnm
EXPOSE 7447 8000
USER 10001:10001
STOPSIGNAL SIGTERM
ENTRYPOINT ["revnm-server"]
CMD ["serve", "--config", "/etc/revnm/server.yaml"]
HEALTHCHECK --interval=30s --timeout=10s --start-period=120s --retries=3 \
    CMD ["revnm-server", "health", "--config", "/etc/revnm/server.yaml"]
ARG VERSION=unknown
ARG REVISION=unknown
LABEL org.opencontainers.image.title="ReVNM server" \
      org.opencontainers.image.description="A camera on the wall guides robots without cameras: perception, policy, HTTP API and page" \
      org.opencontainers.image.licenses="Apache-2.0" \
      org.opencontainers.image.version="${VERSION}" \
      org.opencontainers.image.revision="${REVISION}"

FROM server AS simulator
COPY --from=build-simulator /packages /opt/revnm
ENTRYPOINT ["revnm-sim"]
CMD ["run"]
HEALTHCHECK NONE
LABEL org.opencontainers.image.title="ReVNM simulator" \
      org.opencontainers.image.description="Stands in for camera and robot"
