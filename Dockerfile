# The suite on Ubuntu 24.04 with Python 3.12, without a ROS installation: nodes, commands, messages.
#   docker build -t whereabouts .
#   docker run --rm --network host -v "$PWD:/data" whereabouts run --config /data/robot.yaml
FROM ubuntu:24.04

SHELL ["/bin/bash", "-o", "pipefail", "-c"]
# Versions are those of the release; requirements/lock.txt pins what follows from PyPI.
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install -y --no-install-recommends build-essential ca-certificates git make python3 python3-dev python3-venv \
    && rm -rf /var/lib/apt/lists/*

WORKDIR /opt/whereabouts
# What is installed changes seldom; what is written changes often.
COPY requirements requirements
RUN python3 -m venv .venv \
    && .venv/bin/pip install --no-cache-dir --require-hashes -r requirements/lock.txt
COPY . .
RUN make setup

# Each user has a state directory of his own: maps and the world's memory go there.
RUN useradd --create-home --uid 1001 robot && chown -R robot /opt/whereabouts
USER 1001
ENV PATH=/opt/whereabouts/.venv/bin:$PATH
ENTRYPOINT ["whereabouts"]
CMD ["--help"]
