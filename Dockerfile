# novags on a processor:
#   docker build -t novags --build-arg TORCH_INDEX=ADDRESS .     ADDRESS: the index that pytorch.org gives for pip and CPU;
#   docker run --rm -v "$PWD/out:/novags-work/out" novags run           without it, torch comes with CUDA, several GB
FROM python:3.11-slim
# libLLVM: for Mitsuba's fast variants.
ARG TORCH_INDEX=
RUN apt-get update -qq && apt-get install -y -qq --no-install-recommends libllvm19 && rm -rf /var/lib/apt/lists/*
WORKDIR /novags
COPY pyproject.toml README.md LICENSE ./
COPY novags novags
COPY simscenes simscenes
COPY sensor_model sensor_model
RUN PIP_EXTRA_INDEX_URL=$TORCH_INDEX pip install --no-cache-dir .
WORKDIR /novags-work
ENV NUMBA_CACHE_DIR=/opt/novags-kernels
RUN python -m novags.warm
ENTRYPOINT ["novags"]
