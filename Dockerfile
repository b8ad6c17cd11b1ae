# gnomon in a container, as a user that is not root. The recording's folder is mounted as /data:
#     docker build -t gnomon .
#     docker run --rm -v "$PWD:/data" gnomon imu log.csv
FROM python:3.13-slim AS build
RUN apt-get update && apt-get install -y --no-install-recommends gcc libc6-dev && rm -rf /var/lib/apt/lists/*
COPY . /source
RUN python -m venv /opt/gnomon && /opt/gnomon/bin/pip install --no-cache-dir /source

FROM python:3.13-slim
COPY --from=build /opt/gnomon /opt/gnomon
RUN useradd --create-home gnomon && mkdir /data && chown gnomon /data
USER gnomon
WORKDIR /data
ENTRYPOINT ["/opt/gnomon/bin/gnomon"]
CMD ["--help"]
