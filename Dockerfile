# dynappo on a host with an NVIDIA GPU; how to build and run it: docs/install.md
FROM python:3.12-slim

# films are rendered through EGL
RUN apt-get update \
 && apt-get install -y --no-install-recommends libegl1 \
 && rm -rf /var/lib/apt/lists/*

WORKDIR /dynappo
COPY pyproject.toml constraints.txt README.md LICENSE ./
COPY configs configs
COPY robots robots
COPY dynappo dynappo

# for a driver before 580: --build-arg EXTRAS=cuda12,video
ARG EXTRAS=cuda13,warp,video
RUN pip install --no-cache-dir -c constraints.txt -e ".[${EXTRAS}]"

# the host's driver lends its compute libraries, and EGL; compiled programs are kept in /cache
ENV NVIDIA_DRIVER_CAPABILITIES=compute,utility,graphics XDG_CACHE_HOME=/cache
VOLUME ["/cache", "/dynappo/runs"]

ENTRYPOINT ["python", "-m", "dynappo"]
CMD ["--help"]
