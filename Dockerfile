# docker build -t realsim .
# docker run --rm --user "$(id -u):$(id -g)" -v "$PWD:/data" realsim reconstruct my_capture --out scene
FROM python:3.11-slim-bookworm
ARG EXTRAS=recon,viewer,phone,lidar,logs,usd,mcp
COPY tools/system_packages.sh constraints.txt /tmp/
RUN bash /tmp/system_packages.sh && rm -rf /var/lib/apt/lists/*
COPY pyproject.toml README.md LICENSE /src/
COPY realsim /src/realsim
COPY trainer /src/trainer
RUN pip install --no-cache-dir --constraint /tmp/constraints.txt "/src[${EXTRAS}]" && rm -rf /src
ENV MUJOCO_GL=osmesa HOME=/tmp
WORKDIR /data
ENTRYPOINT ["realsim"]
CMD ["--help"]
