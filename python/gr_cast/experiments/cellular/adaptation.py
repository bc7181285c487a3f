# SPDX-License-Identifier: GPL-3.0-or-later
"""Link adaptation of LTE: from the SINR of all subcarriers to a CQI and a bit rate, by published tables.

| figure | source |
|---|---|
| CQI, modulation, code rate, efficiency | 3GPP TS 36.213, table 7.2.3-1 |
| EESM beta and SINR for 10 % block errors per CQI | Fan, Yin, Li, Peng, Zhu, "MCS selection for throughput improvement in downlink LTE systems", ICCCN 2011 |
| effective SINR −β·ln(mean(exp(−SINR/β))) | Ericsson, 3GPP R1-031303 (EESM) |
| 126 data symbols per resource block and ms | TS 36.213, 7.2.3: 3 control symbols, one port's reference symbols taken off |
"""  # noqa: E501

import numpy as np

BLOCK_ERROR_RATE = 0.1  # that a CQI promises; what it loses is counted as lost everywhere
DATA_SYMBOLS_PER_BLOCK_MS = 126
EFFICIENCY = np.array(  # bits per symbol of CQI 0 (out of range) to 15
    [0, 0.1523, 0.2344, 0.3770, 0.6016, 0.8770, 1.1758, 1.4766, 1.9141, 2.4063, 2.7305, 3.3223, 3.9023, 4.5234, 5.1152, 5.5547]
)
BETA = np.array([1.00, 1.40, 1.40, 1.48, 1.50, 1.62, 3.10, 4.32, 5.37, 7.71, 15.5, 19.6, 24.7, 27.6, 28.0])  # CQI 1 to 15
NEEDED_SINR_DB = np.array(
    [-9.478, -6.658, -4.098, -1.798, 0.399, 2.424, 4.489, 6.367, 8.456, 10.266, 12.218, 14.122, 15.849, 17.786, 19.809]
)


def effective_sinr_db(sinr: np.ndarray, beta: float) -> float:
    """The SINR in white noise that does as well as these subcarriers, linear (F,), do together (EESM)."""
    least = sinr.min()  # taken out so that nothing underflows: the weakest subcarriers decide
    return float(10 * np.log10(max(least - beta * np.log(np.mean(np.exp(-(sinr - least) / beta))), 1e-30)))


def cqi(sinr: np.ndarray) -> int:
    """The highest CQI (0: none) whose blocks get through nine times of ten over subcarriers of SINR (F,), linear."""
    good = [effective_sinr_db(sinr, beta) >= needed for beta, needed in zip(BETA, NEEDED_SINR_DB, strict=True)]
    return max((index + 1 for index, enough in enumerate(good) if enough), default=0)


def rate_bps(index: int, blocks: int) -> float:
    """Bits per s that arrive with all `blocks` resource blocks at a CQI."""
    return float(EFFICIENCY[index] * blocks * DATA_SYMBOLS_PER_BLOCK_MS * 1e3 * (1 - BLOCK_ERROR_RATE))
