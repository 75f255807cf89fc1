# Sightline with its kernels compiled: no first run waits for them. Not built in the project's own checks, which have no Docker.
#   docker build -t sightline .
#   docker run --rm --user "$(id -u):$(id -g)" -v "$PWD":/data sightline recover acquisition.toml --out result
FROM python:3.13-slim AS wheel
COPY . /source
RUN pip install --no-cache-dir hatchling && cd /source && hatchling build --target wheel --directory /dist

FROM python:3.13-slim
COPY constraints.txt /tmp/
COPY --from=wheel /dist/*.whl /tmp/
# the same versions, by hash, as everywhere else
RUN pip install --no-cache-dir --require-hashes -r /tmp/constraints.txt \
    && pip install --no-cache-dir --no-deps /tmp/*.whl \
    && rm /tmp/*.whl /tmp/constraints.txt
# kernels lie where every user may read them; who may not write there runs them all the same
ENV NUMBA_CACHE_DIR=/opt/sightline-kernels
RUN mkdir -p $NUMBA_CACHE_DIR && sightline warm-up && chmod -R a+rX $NUMBA_CACHE_DIR
WORKDIR /data
ENTRYPOINT ["sightline"]
CMD ["--help"]
