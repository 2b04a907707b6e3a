"""CARI as loops over lists of numbers, from Section 3.3 of the paper, without shared code.

All values are float64 numpy arrays of one anchor at a time, without optimisation.
"""

import math

import numpy as np

from splatwire.types import AnchorLayout, Prior

ALPHA, BETA, GAMMA, DELTA = 1.0, 2.0, 1.0, 1.5
CONFIDENCE_RECOVERED = 0.5


def cos_sim(a, b):
    length = math.sqrt(sum(v * v for v in a)) * math.sqrt(sum(v * v for v in b))
    return sum(v * w for v, w in zip(a, b, strict=True)) / length if length > 0 else 0.0


def cari(context, num_candidates, num_neighbors, passes, eps):
    """Returns features, scalings, offsets, mask (numpy) of all anchors."""
    anchors, prior, layout = context.scene.anchors, context[Prior], context[AnchorLayout]
    x = anchors.positions.double().numpy()
    f_hash = prior.context_features.double().tolist()
    n, slots = anchors.mask.shape
    gap = [[math.dist(x[a], x[b]) for b in range(n)] for a in range(n)]
    alike = [[(cos_sim(f_hash[a], f_hash[b]) + 1) / 2 for b in range(n)] for a in range(n)]
    received = context.loss_mask.received.numpy()
    mu = [prior.feature.mean, prior.scaling.mean, prior.offset.mean]
    mu = [m.double().numpy() for m in mu]
    y = [anchors.features, anchors.scalings, anchors.offsets.flatten(1)]
    y = [v.double().numpy() for v in y]
    scale = [p.scale.double().numpy() for p in (prior.feature, prior.scaling, prior.offset)]
    mask = anchors.mask.numpy().copy()
    mask[~received[:, 3]] = True  # unknown until a vote has replaced it

    # (attribute, columns within it) of the feature groups, scaling and offsets
    groups, start = [], 0
    for size in layout.feature_groups:
        groups.append((0, range(start, start + size)))
        start += size
    groups += [(1, range(6)), (2, range(3 * slots))]

    def sigma(k, attribute, columns):
        return float(np.mean([scale[attribute][k, c] for c in columns]))

    # residuals; None where not yet available
    r = [[None] * n for _ in range(3)]
    for a in range(3):
        for k in range(n):
            if received[k, a]:
                r[a][k] = y[a][k] - mu[a][k]
    exists = anchors.mask.numpy() & received[:, 2:3] & received[:, 3:4]

    def signature(k):
        g = []
        for attribute, columns in groups[:-1]:
            g.append(0.0 if r[attribute][k] is None else float(np.mean([r[attribute][k][c] for c in columns])))
        entries = (
            [] if r[2][k] is None else [r[2][k][3 * s + d] for s in range(slots) if exists[k, s] for d in range(3)]
        )
        g.append(float(np.mean(entries)) if entries else 0.0)
        return g

    def strongest(q, column, attribute, columns, support, confidence, g):
        near = sorted(support, key=lambda k: (gap[q][k], k))[:num_candidates]
        scored = []
        for k in near:
            d = gap[q][k]
            h = alike[q][k]
            rho = (cos_sim(g[q], g[k]) + 1) / 2
            w_geo = (d + eps) ** (-ALPHA / 2)
            w_ctx = h**BETA
            w_unc = (sigma(k, attribute, columns) + eps) ** -GAMMA
            w_sig = rho**DELTA
            scored.append((w_geo * w_ctx * w_unc * confidence(k, column) * w_sig, k))
        scored.sort(key=lambda pair: -pair[0])
        kept = scored[:num_neighbors]
        total = sum(u for u, _ in kept) + eps
        return [(u / total, k) for u, k in kept]

    for t in range(passes):
        g = [signature(k) for k in range(n)]
        r_old = [[None if v is None else v.copy() for v in column] for column in r]
        mask_old, exists_old = mask.copy(), exists.copy()

        def confidence(k, column):
            return 1.0 if received[k, column] else CONFIDENCE_RECOVERED

        def support_of(q, column, number=t):
            if not received[:, column].any():
                return []
            return [k for k in range(n) if k != q and (received[k, column] or number > 0)]

        for q in range(n):
            for attribute, columns in groups:
                if received[q, attribute]:
                    continue
                chosen = strongest(q, attribute, attribute, columns, support_of(q, attribute), confidence, g)
                if not chosen:
                    continue
                if r[attribute][q] is None or len(r[attribute][q]) != mu[attribute].shape[1]:
                    r[attribute][q] = np.zeros(mu[attribute].shape[1])
                for c in columns:
                    r[attribute][q][c] = 0.0
                    if attribute < 2:
                        for w, k in chosen:
                            r[attribute][q][c] += w * r_old[attribute][k][c]
                    else:
                        having = [(w, k) for w, k in chosen if exists_old[k, c // 3]]
                        if having:
                            share = sum(w for w, _ in chosen) / sum(w for w, _ in having)
                            r[attribute][q][c] = sum(w * share * r_old[attribute][k][c] for w, k in having)
            if not received[q, 3]:
                chosen = strongest(q, 3, 2, range(3 * slots), support_of(q, 3), confidence, g)
                if chosen and sum(w for w, _ in chosen) > 0:
                    for s in range(slots):
                        votes = sum(w for w, k in chosen if mask_old[k, s]) / sum(w for w, _ in chosen)
                        mask[q, s] = votes >= 0.5
        for k in range(n):
            if received[k, 2] and received[k, 3]:
                exists[k] = anchors.mask.numpy()[k]
            elif received[k, 2]:
                exists[k] = False
            else:
                exists[k] = mask[k]

    out = [np.array([y[a][k] if received[k, a] else mu[a][k] + (0 if r[a][k] is None else r[a][k]) for k in range(n)])
           for a in range(3)]  # fmt: skip
    if received[:, 1].any():
        out[1] = np.maximum(out[1], out[1][received[:, 1]].min(axis=0))
    else:
        out[1] = np.maximum(out[1], 0)
    out[2] = out[2] * mask.repeat(3, axis=1)
    return out[0], out[1], out[2], mask
