#!/usr/bin/env bash
# What nobody could measure without a card: the tests that need one, then bonsai_30k trained by both models beside the
# official run, and a table of it. About 40 minutes; $SPLATWIRE_DATA has the photos and the official figures.
#
#     pip install -e '.[gpu]' --group dev      # torch must be a CUDA build
#     benchmarks/gpu.sh [FOLDER]               # logs and results; out_gpu if absent
#     benchmarks/gpu.sh --dry-run [FOLDER]     # every part on the CPU, at a size that takes two minutes
set -euo pipefail

device=cuda run=bonsai_30k more=() minutes=17
if [ "${1:-}" = --dry-run ]; then
    device=cpu run=snowmiku_small_2400 more=(--iterations 200 --threads 1) minutes=30
    shift
fi
folder=$(realpath -m "${1:-out_gpu}")
cd "$(dirname "$0")/.."
mkdir -p "$folder"
[ "$device" = cpu ] || python -c 'from splatwire.cli.train import check_device; check_device("cuda")'

# Where there is no card these tests run against a stand-in for gsplat, or say why they were skipped.
passed=0
python -m pytest -q -rs tests/parity/test_gsplat.py tests/render/test_gsplat_backend.py tests/train/test_gpu.py \
    2>&1 | tee "$folder/tests.log" || passed=$?
for model in hacpp causal; do
    python benchmarks/train.py --run "$run" --device "$device" --model "$model" --minutes "$minutes" "${more[@]}" \
        --output "$folder/$model.scene" --json "$folder/$model.json" >"$folder/$model.log"
done
echo
tail -n 1 "$folder/tests.log"
python benchmarks/train.py --table "$folder/hacpp.json" "$folder/causal.json"
exit "$passed"
