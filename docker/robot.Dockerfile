# The client on the robot, for amd64 and arm64. How to build and run: docs/containers.md

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
ENV PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_CONSTRAINT=/src/constraints.txt
WORKDIR /src
COPY constraints.txt docker/requirements.py ./
COPY robot_client/pyproject.toml robot_client/
# kachaka: with what its driver needs
ARG EXTRA=""
RUN python3 -m venv --without-pip /opt/revnm \
    && python3 requirements.py "robot_client[${EXTRA}]" > robot.txt \
    && python3 -m pip --python /opt/revnm/bin/python install --only-binary :all: --requirement robot.txt
COPY robot_client robot_client
RUN python3 -m pip --python /opt/revnm/bin/python install --no-deps --prefix /packages ./robot_client

FROM python AS robot
RUN useradd --uid 10001 --home-dir /nonexistent --no-create-home --shell /usr/sbin/nologin revnm
COPY --from=build /opt/revnm /opt/revnm
COPY --from=build /packages /opt/revnm
COPY LICENSE NOTICE /usr/share/doc/revnm/
ENV PATH=/opt/revnm/bin:$PATH PYTHONUNBUFFERED=1
# Where paths in the settings file count from.
WORKDIR /etc/revnm
USER 10001:10001
STOPSIGNAL SIGTERM
ENTRYPOINT ["revnm-robot"]
CMD ["run", "--config", "/etc/revnm/robot.yaml"]
ARG VERSION=unknown
ARG REVISION=unknown
LABEL org.opencontainers.image.title="ReVNM robot client" \
      org.opencontainers.image.description="Drives a robot with a 2D LiDAR along the plans of a ReVNM server, and stops it in time" \
      org.opencontainers.image.licenses="Apache-2.0" \
      org.opencontainers.image.version="${VERSION}" \
      org.opencontainers.image.revision="${REVISION}"
