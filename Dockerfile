# A relay: serves streams as another user, with nothing to write to.
#
#   docker build -t splatwire .                                # EXTRAS=all where streams have to be packed anew
#   docker run --read-only --cap-drop ALL -v "$PWD:/streams:ro" -p 4840:4840/udp -p 8080:8080 splatwire \
#       serve /streams/scene.swz --host 0.0.0.0 --page 8080
FROM python:3.12-slim AS built
ARG EXTRAS=relay
COPY pyproject.toml README.md LICENSE /source/
COPY src /source/src
RUN python -m venv /splatwire && /splatwire/bin/pip install --no-cache-dir "/source[${EXTRAS}]"

FROM python:3.12-slim
COPY --from=built /splatwire /splatwire
ENV PYTHONDONTWRITEBYTECODE=1 PYTHONUNBUFFERED=1
USER 65532:65532
WORKDIR /streams
EXPOSE 4840/udp 8080/tcp
ENTRYPOINT ["/splatwire/bin/splatwire"]
CMD ["--help"]
