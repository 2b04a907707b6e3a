#!/usr/bin/env bash
# Runs GPU tests, measures the speed of an iteration, trains bonsai_30k with both models and prints a table with the
# official run. Takes about 45 minutes; $SPLATWIRE_DATA has the photos and the official figures.
#
#     pip install -e '.[gpu]' --group dev           # torch must be a CUDA build
#     benchmarks/gpu.sh [FOLDER]                    # logs and results; default out_gpu
#     benchmarks/gpu.sh --short [FOLDER]            # about 12 minutes: speed, and a shortened run of the causal model
#     benchmarks/gpu.sh --dry-run [--short] [FOLDER]   # every part on the CPU, in minutes
set -euo pipefail

device=cuda run=bonsai_30k scene=bonsai more=() minutes=17 models=(hacpp causal)
speed=(--anchors 270000)
if [ "${1:-}" = --dry-run ]; then
    device=cpu run=snowmiku_small_2400 scene=snowmiku_small more=(--iterations 200 --threads 1) minutes=30
    speed=(--anchors 3000 --warm 2 --iterations 4 --profile 2)
    shift
fi
if [ "${1:-}" = --short ]; then
    models=(causal) minutes=8
    [ "$device" = cpu ] || more=(--fit 7 --threads 8)
    shift
fi
folder=$(realpath -m "${1:-out_gpu}")
cd "$(dirname "$0")/.."
mkdir -p "$folder"
[ "$device" = cpu ] || python -c 'from splatwire.cli._run_train import check_device; check_device("cuda")'

# Without a GPU these tests use a stand-in for gsplat or skip with a reason.
passed=0
python -m pytest -q -rs tests/parity/test_gsplat.py tests/render/test_gsplat_backend.py tests/neural/training/test_gpu.py \
    2>&1 | tee "$folder/tests.log" || passed=$?
python benchmarks/gpu_speed.py --data "${SPLATWIRE_DATA:-../shared/data}" --scene "$scene" --device "$device" \
    "${speed[@]}" --code --json "$folder/speed.json" >"$folder/speed.log"
results=()
for model in "${models[@]}"; do
    python benchmarks/train.py --run "$run" --device "$device" --model "$model" --minutes "$minutes" "${more[@]}" \
        --speed "$folder/speed.json" --output "$folder/$model.scene" --json "$folder/$model.json" >"$folder/$model.log"
    results+=("$folder/$model.json")
done
echo
tail -n 1 "$folder/tests.log"
grep -E '"(anchors|its_per_s|launches|host_copies)"' "$folder/speed.json"
python benchmarks/train.py --table "${results[@]}"
exit "$passed"
