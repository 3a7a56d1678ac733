# The commands on a CPU, without a network: see "Install" in README.md. With `--target serve`, the studio: docs/serving.md.
FROM python:3.12-slim AS build
WORKDIR /source
COPY pyproject.toml README.md LICENSE NOTICE ./
COPY configs configs
COPY t2m_jax t2m_jax
RUN pip wheel --no-cache-dir --no-deps --wheel-dir /wheels .

FROM python:3.12-slim AS commands
# Everybody may write to the home folder, because `docker run --user` gives the files of a mounted folder their owner.
RUN --mount=type=bind,from=build,source=/wheels,target=/wheels \
    pip install --no-cache-dir /wheels/*.whl \
    && useradd --create-home --uid 10001 t2m \
    && mkdir /work \
    && chmod 1777 /home/t2m /work
USER 10001
ENV HOME=/home/t2m
WORKDIR /work
ENTRYPOINT ["t2m"]

FROM commands AS serve
USER 0
RUN --mount=type=bind,from=build,source=/wheels,target=/wheels \
    pip install --no-cache-dir "$(echo /wheels/*.whl)[serve,video]"
USER 10001
EXPOSE 8000
HEALTHCHECK --start-period=60s CMD ["python", "-c", "import urllib.request; urllib.request.urlopen('http://127.0.0.1:8000/health')"]
ENTRYPOINT ["t2m", "serve", "--host", "0.0.0.0"]

# Without --target.
FROM commands
