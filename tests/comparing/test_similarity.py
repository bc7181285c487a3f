# SPDX-License-Identifier: GPL-3.0-or-later
"""Similarity against closed forms, NumPy and SciPy."""

import numpy as np
import pytest
from gr_cast.comparing import similarity as cmp
from gr_cast.comparing.series import Series
from gr_cast.core.errors import CastError
from gr_cast.experiments import paper
from scipy import signal

N = 1000
PAPER = sorted({c["rho_sinr"] for c in paper.figures()["jamming"]["cases"].values()} | {0.937, 0.999})


def series(value, step_s=0.1, start_s=0.0, name="s"):
    return Series(name=name, time_s=start_s + step_s * np.arange(len(value)), value=value)


def wave(cycles, size=N, phase_rad=0.0):
    return np.cos(2 * np.pi * cycles * np.arange(size) / size + phase_rad)


def autoregressive(rng, memory, size, innovations=None):
    """AR(1) of unit power, started in its stationary law."""
    drive = rng.normal(size=size) if innovations is None else innovations
    drive = drive * np.sqrt(1 - memory**2)
    drive[0] /= np.sqrt(1 - memory**2)
    return signal.lfilter([1], [1, -memory], drive)


@pytest.mark.parametrize("rho", PAPER)
def test_two_series_built_to_the_papers_similarity_have_it(rho):
    a = wave(37)
    b = rho * a + np.sqrt(1 - rho**2) * wave(90)  # whole periods of two frequencies are orthogonal
    found = cmp.compare(series(3 + 2 * a), series(-7 + 0.5 * b))
    assert found.rho == pytest.approx(rho, abs=1e-9) and found.lag == 0
    low, high = found.rho_interval
    assert low < rho < high < 1


def test_at_one_lag_similarity_is_pearsons_correlation():
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(2, 300))
    assert cmp.similarity(a, b, 0)[0] == pytest.approx(np.corrcoef(a, b)[0, 1], abs=1e-12)


def test_over_lags_similarity_is_scipys_cross_correlation():
    rng = np.random.default_rng(2)
    a, b = rng.normal(size=400), rng.normal(size=370)
    x, y = a - a.mean(), np.append(b - b.mean(), np.zeros(30))
    whole = signal.correlate(y, x, "full") / np.sqrt(np.sum(x**2) * np.sum(y**2))
    rho, lag, over_lags = cmp.similarity(a, b, 10)
    np.testing.assert_allclose(over_lags, whole[399 - 10 : 399 + 11], atol=1e-12)
    assert rho == pytest.approx(np.max(over_lags)) and over_lags[lag + 10] == rho


@pytest.mark.parametrize("phase_rad", [0.3, 1.0, np.pi / 2, 2.0])
def test_a_phase_shift_costs_its_cosine(phase_rad):
    rho, _, _ = cmp.similarity(wave(50), wave(50, phase_rad=phase_rad), 0)
    assert rho == pytest.approx(np.cos(phase_rad), abs=1e-12)


@pytest.mark.parametrize("kept", [200, 500, 900])
def test_the_shorter_series_is_padded_with_zeros_after_its_mean_is_taken(kept):
    a = 20 + wave(50)
    for pair in ((a, a[:kept]), (a[:kept], a)):
        assert cmp.similarity(*pair, 0)[0] == pytest.approx(np.sqrt(kept / N), abs=1e-12)


@pytest.mark.parametrize("lag", [-7, -1, 0, 4, 10])
def test_a_positive_lag_says_that_b_is_later(lag):
    rng = np.random.default_rng(3)
    long = autoregressive(rng, 0.5, N + 40)
    found = cmp.compare(series(long[20:-20]), series(long[20 - lag : N + 20 - lag]))
    assert found.lag == lag and found.rho > 0.98
    assert found.slope == pytest.approx(1, abs=1e-9)
    assert any(line.startswith("lag:") for line in found.blind_spots) == (lag != 0)


def test_beyond_the_last_lag_nothing_is_found():
    rng = np.random.default_rng(4)
    a = rng.normal(size=N + 20)
    assert cmp.compare(series(a[20:]), series(a[:N])).rho < 0.2
    assert cmp.compare(series(a[20:]), series(a[:N]), max_lag=20).lag == 20


def test_gain_and_offset_leave_similarity_alone_and_are_told():
    a = wave(20)
    found = cmp.compare(series(a), series(5 + 2 * a))
    assert found.rho == pytest.approx(1, abs=1e-12)
    assert found.bias == pytest.approx(5) and found.slope == pytest.approx(2)
    assert found.rmse == pytest.approx(np.sqrt(25 + 0.5))  # offset² + mean of cos²
    assert {line.split(":")[0] for line in found.blind_spots} >= {"bias", "slope"}


def test_equal_series_have_no_blind_spot():
    a = np.random.default_rng(9).normal(size=N)
    found = cmp.compare(series(a), series(a))
    assert (found.rho, found.lag, found.bias, found.rmse) == (pytest.approx(1), 0, 0, 0)
    assert found.blind_spots == ()


def test_a_change_of_level_that_carries_similarity_is_told():
    rng = np.random.default_rng(5)
    step = np.where(np.arange(600) // 200 == 1, 0.0, 30.0)
    found = cmp.compare(series(step + rng.normal(size=600)), series(step + rng.normal(size=600)))
    assert found.rho > 0.99
    assert any(line.startswith("levels:") for line in found.blind_spots)


@pytest.mark.parametrize("constant", [0.0, 0.1, -3.3])
def test_a_constant_series_has_no_similarity_but_a_bias(constant):
    found = cmp.compare(series(np.full(50, constant)), series(wave(5, 50)))
    assert found.rho is None and found.lag is None and found.rho_interval is None
    assert found.bias == pytest.approx(-constant)
    for pair in ((np.full(50, constant), wave(5, 50)), (wave(5, 50), np.full(50, constant))):
        rho, lag, at_lags = cmp.similarity(*pair, 3)
        assert np.isnan(rho) and lag == 0 and np.isnan(at_lags).all() and len(at_lags) == 7
    assert cmp.as_document(found)["rho"] is None
    assert any("constant" in line for line in found.blind_spots)


def test_missing_values_are_refused_and_with_a_step_interpolated():
    value = wave(3, 100)
    value[10] = np.nan
    with pytest.raises(CastError, match="1 of 100 values are missing, the first at 1 s"):
        cmp.compare(series(value), series(value))
    line = np.arange(100.0)
    broken = np.where(line == 10, np.nan, line)
    found = cmp.compare(series(line), series(broken), step_s=0.1)
    assert found.rmse == pytest.approx(0, abs=1e-12)


def test_unequal_steps_are_refused_and_with_a_step_averaged():
    rng = np.random.default_rng(6)
    times = np.sort(rng.uniform(0, 100, 4000))
    times[0] = 0
    uneven = Series(name="uneven", time_s=times, value=np.sin(times / 3))
    even = series(np.sin(np.arange(0, 100, 0.05) / 3), 0.05)
    with pytest.raises(CastError, match="uneven.*equal"):
        cmp.compare(uneven, even)
    with pytest.raises(CastError, match="every 0.1 s.*every 0.2 s"):
        cmp.compare(series(wave(5, 50), 0.1), series(wave(5, 50), 0.2))
    found = cmp.compare(uneven, even, step_s=1.0)
    assert found.rho > 0.999 and found.step_s == 1.0


@pytest.mark.parametrize(
    "times, values, words",
    [
        ([0, 1, 1], [1, 2, 3], "ascend"),
        ([0, 1], [1, np.inf], "infinite"),
        ([0], [1], "2 or more"),
        ([0, np.nan], [1, 2], "finite"),
        ([0, 1, 2], [1, 2], "one value per time"),
    ],
)
def test_what_is_no_series_is_refused(times, values, words):
    with pytest.raises(CastError, match=words):
        Series(name="s", time_s=times, value=values)


@pytest.mark.parametrize("max_lag", [-1, 50])
def test_a_lag_that_the_series_do_not_have_is_refused(max_lag):
    with pytest.raises(CastError, match="max lag"):
        cmp.compare(series(wave(5, 50)), series(wave(5, 50)), max_lag=max_lag)


@pytest.mark.parametrize("memory", [0.0, 0.6, 0.9])
def test_independent_samples_are_those_of_autoregressive_series(memory):
    rng = np.random.default_rng(7)
    found = [cmp.independent_samples(*(autoregressive(rng, memory, 2000) for _ in range(2))) for _ in range(40)]
    law = 2000 * (1 - memory**2) / (1 + memory**2)  # n / Σ memory^(2|k|)
    assert np.median(found) == pytest.approx(law, rel=0.2)


def test_independent_samples_of_a_short_wave_are_bartletts_double_sum():
    """n² / Σ_ij ρ_a(i − j) ρ_b(i − j) over pairs up to half the series apart: far ones are fewer, hence the taper."""
    n = 64
    a, b = wave(2, n), wave(2, n, 0.4)

    def correlogram(x):
        full = np.correlate(x - x.mean(), x - x.mean(), "full")[n - 1 :]
        return full / full[0]

    apart = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    total = np.sum((correlogram(a) * correlogram(b))[apart] * (apart <= n // 2)) / n
    assert 2 < n / total < 10
    assert cmp.independent_samples(a, b) == pytest.approx(n / total, rel=1e-9)


@pytest.mark.parametrize("memory", [0.5, 0.8])
def test_blocks_of_autoregressive_series_are_as_long_as_politis_and_white_say(memory):
    """(2 g² / d · n)^(1/3) in closed form; without the flat-top taper it scatters, with another it is too short."""
    n, rng = 4000, np.random.default_rng(11)
    found = np.array([cmp.block_length(autoregressive(rng, memory, n)) for _ in range(60)])
    law = (1.5 * (2 * memory / (1 - memory**2)) ** 2 * n) ** (1 / 3)
    assert np.mean(found) == pytest.approx(law, rel=0.06)
    assert np.std(found) < 0.2 * law


def test_few_independent_samples_are_told_and_many_are_not():
    slow = cmp.compare(series(wave(1, 200)), series(wave(1, 200, 0.3)))
    noise = np.random.default_rng(3).normal(size=(2, 2000))
    quick = cmp.compare(series(noise[0]), series(noise[0] + 0.1 * noise[1]))
    assert slow.independent_samples < 10 and any(line.startswith("memory") for line in slow.blind_spots)
    assert quick.independent_samples > 1000 and not any(line.startswith("memory") for line in quick.blind_spots)


@pytest.mark.parametrize("memory", [0.0, 0.7])
@pytest.mark.parametrize("rho", [0.3, 0.95])
def test_the_interval_covers_the_true_correlation(memory, rho):
    rng = np.random.default_rng(8)
    held, trials = 0, 150
    for _ in range(trials):
        drive = rng.normal(size=(2, 400))
        a = autoregressive(rng, memory, 400, drive[0].copy())
        b = autoregressive(rng, memory, 400, rho * drive[0] + np.sqrt(1 - rho**2) * drive[1])
        (low, high), _ = cmp.rho_interval(a, b, rng, 300)
        held += low <= rho <= high
    assert 0.86 <= held / trials <= 0.99


def spots(found):
    return {line.split(":")[0] for line in found.blind_spots}


def test_neither_unit_nor_offset_changes_what_is_said_of_similarity():
    rng = np.random.default_rng(12)
    a = autoregressive(rng, 0.8, 300)
    b = 0.7 * a + autoregressive(rng, 0.8, 300)
    plain = cmp.compare(series(a), series(b))
    for scale, offset in ((1e-6, 0.0), (1e5, 0.0), (1.0, 40.0)):
        found = cmp.compare(series(scale * a + offset), series(scale * b + offset))
        assert found.rho_interval == pytest.approx(plain.rho_interval, abs=1e-9)
        assert (found.block_samples, found.lag) == (plain.block_samples, plain.lag)
        assert found.independent_samples == pytest.approx(plain.independent_samples, rel=1e-6)
        assert found.slope == pytest.approx(plain.slope) and spots(found) == spots(plain)


@pytest.mark.parametrize(("sigmas", "told"), [(1.9, False), (2.1, True), (-1.9, False), (-2.1, True)])
def test_a_bias_is_told_from_two_standard_deviations_of_its_own_mean_on(sigmas, told):
    """Of white differences the mean's deviation is σ/√n."""
    rng = np.random.default_rng(13)
    a, error = rng.normal(size=(2, N))
    error = (error - error.mean()) / error.std()
    assert cmp.independent_samples(error, error) == N
    found = cmp.compare(series(10 * a), series(10 * a + error + sigmas / np.sqrt(N)))
    assert ("bias" in spots(found)) == told


@pytest.mark.parametrize(("share", "told"), [(2e-9, True), (0.5e-9, False)])
def test_an_offset_alone_is_a_bias_unless_numbers_cannot_tell(share, told):
    whole = np.round(1e4 * wave(5)) * 2.0**20  # sums of these are exact
    offset = 2.0 ** np.round(np.log2(share * np.abs(whole).max()))
    assert ("bias" in spots(cmp.compare(series(whole), series(whole + offset)))) == told


@pytest.mark.parametrize(("slope", "told"), [(1.09, False), (0.91, False), (1.11, True), (0.89, True), (-1.0, True)])
def test_a_slope_is_told_from_a_tenth_on(slope, told):
    found = cmp.compare(series(wave(7)), series(slope * wave(7)), max_lag=0)
    assert found.slope == pytest.approx(slope) and ("slope" in spots(found)) == told


@pytest.mark.parametrize(("beside", "told"), [(1.009, False), (1 / 1.009, False), (1.011, True), (1 / 1.011, True)])
def test_steps_of_two_series_may_differ_by_a_hundredth(beside, told):
    pair = series(wave(5, 50), 0.1), series(wave(5, 50), 0.1 * beside)
    if told:
        with pytest.raises(CastError, match="needs one step"):
            cmp.compare(*pair)
    else:
        assert cmp.compare(*pair).rho == pytest.approx(1)


@pytest.mark.parametrize(("lag", "side"), [(3, "later"), (-3, "earlier")])
def test_a_lag_is_told_in_samples_seconds_and_direction(lag, side):
    long = np.random.default_rng(3).normal(size=N + 40)
    found = cmp.compare(series(long[20:-20]), series(long[20 - lag : N + 20 - lag]))
    assert f"lag: B is 3 samples (0.3 s) {side} than A where ρ is largest" in found.blind_spots
    assert cmp.as_document(found)["lag_s"] == pytest.approx(0.1 * lag)


def test_lengths_are_told_where_they_differ():
    assert "length: 100 and 90 samples; the shorter is padded with its mean, which lowers ρ" in (
        cmp.compare(series(wave(5, 100)), series(wave(5, 100)[:90])).blind_spots
    )


def test_a_correlogram_has_memory_up_to_the_last_lag_from_which_five_stay_within_chance():
    """Politis and White 2004: the smallest m with |ρ(m + k)| < 2·√(lg n / n) for k = 1 … max(5, √lg n)."""
    n = 1000
    chance = 2 * np.sqrt(3 / n)
    correlation = np.zeros(n)
    assert cmp._memory(correlation) == 0
    correlation[[1, 2, 3, 7]] = [0.9, -1.001 * chance, 0.999 * chance, 1.001 * chance]
    assert cmp._memory(correlation) == 7  # lags 3 to 6 are four
    correlation[[7, 8]] = 0, 1.001 * chance
    assert cmp._memory(correlation) == 2
    assert cmp._memory(np.ones(n)) == n // 4
    assert cmp._memory(np.concatenate([[1, 0.66], np.zeros(7)])) == 0  # of nine samples lg counts as of ten: 2/3
    assert cmp._memory(np.concatenate([[1, 0.67], np.zeros(7)])) == 1


def test_independent_samples_are_at_most_all():
    alternating = np.tile([1.0, -1.0], 50)
    assert cmp.independent_samples(alternating, np.repeat([1.0, -1.0], 50)) == 100
    slow = np.arange(100.0)
    assert 2 <= cmp.independent_samples(slow, slow) < 5
    assert cmp.independent_samples(np.ones(40), np.arange(40.0)) == 40  # what is constant tells nothing of memory


@pytest.mark.parametrize("n", [12, 30, 100, 900])
def test_blocks_are_no_longer_than_patton_politis_and_white_allow(n):
    """min(3·√n, n/3), which slow waves reach."""
    lengths = [cmp.block_length(wave(cycles, n)) for cycles in (0.5, 1, 3)]
    assert max(lengths) == int(min(3 * np.sqrt(n), n / 3))
    assert cmp.block_length(np.ones(n)) == 1


def test_of_independent_pairs_the_interval_is_fishers():
    """tanh(artanh ρ ± 1.96/√n) for a normal law."""
    rng = np.random.default_rng(14)
    edges, n = [], 1500
    for _ in range(12):
        a, other = rng.normal(size=(2, n))
        b = 0.6 * a + 0.8 * other
        (low, high), block = cmp.rho_interval(a, b, rng, 1000)
        at = np.arctanh(np.corrcoef(a, b)[0, 1])
        edges.append((np.arctanh([low, high]) - at) * np.sqrt(n))
        assert 1 <= block <= 5
    np.testing.assert_allclose(np.mean(edges, axis=0), [-1.96, 1.96], rtol=0.06)


def levels(high, size=40, rho=0.0, seed=15):
    """Two levels 30 apart, `high` of the samples at the upper one, in noise that correlates by `rho`."""
    noise = np.random.default_rng(seed).normal(size=(2, size))
    step = np.where(np.arange(size) < high, 30.0, 0.0)
    return series(step + noise[0]), series(step + rho * noise[0] + np.sqrt(1 - rho**2) * noise[1])


def test_levels_are_told_by_the_correlation_within_them_where_both_have_ten_samples():
    a, b = levels(20)
    halves = [(a.value[part], b.value[part]) for part in (slice(20), slice(20, None))]
    x, y = (np.concatenate([half[k] - half[k].mean() for half in halves]) for k in (0, 1))
    within = np.sum(x * y) / np.sqrt(np.sum(x**2) * np.sum(y**2))
    found = cmp.compare(a, b, max_lag=0)
    assert found.blind_spots[-1].startswith("levels: ") and found.blind_spots[-1].endswith(f"it is {within:.3f}")
    assert "levels" in spots(cmp.compare(*levels(10), max_lag=0))
    assert "levels" not in spots(cmp.compare(*levels(9), max_lag=0))
    assert "levels" not in spots(cmp.compare(*levels(31), max_lag=0))
    assert "levels" not in spots(cmp.compare(*levels(20, rho=0.999), max_lag=0))


def test_document_and_table_tell_every_figure():
    rng = np.random.default_rng(16)
    a = autoregressive(rng, 0.5, 200)
    b = 1 + 0.5 * a + 0.2 * rng.normal(size=200)
    found = cmp.compare(series(a, name="first"), series(b, name="second"), max_lag=4)
    document = cmp.as_document(found)
    slope = np.cov(a, b)[0, 1] / np.var(a, ddof=1)
    r = np.corrcoef(a, b)[0, 1]
    told = {
        "cast_comparison": 1, "kind": "series", "a": "first", "b": "second", "samples": [200, 200], "lag": 0, "lag_s": 0,
        "max_lag": 4, "step_s": pytest.approx(0.1), "rho": pytest.approx(r), "rho_at_lag_0": pytest.approx(r),
        "bias": pytest.approx(np.mean(b - a)), "rmse": pytest.approx(np.sqrt(np.mean((b - a) ** 2))),
        "slope": pytest.approx(slope), "rho_interval": found.rho_interval, "block_samples": found.block_samples,
        "independent_samples": found.independent_samples, "blind_spots": list(found.blind_spots),
    }  # fmt: skip
    assert {key: document[key] for key in told} == told
    low, high = found.rho_interval
    rows = [" ".join(line.split()) for line in cmp.as_table(document).split("\n")]
    assert rows[:7] == [
        f"similarity ρ {r:.4f} 95 %: {low:.4f} to {high:.4f}", "best lag 0 samples (0 s): B later than A", f"ρ at lag 0 {r:.4f}",
        f"bias B − A {np.mean(b - a):.4g}", f"RMSE {found.rmse:.4g}", f"slope B over A {slope:.4g}",
        f"independent samples {found.independent_samples:.1f} of 200",
    ]  # fmt: skip
    assert rows[7:] == [f"blind spot: {line}" for line in found.blind_spots]


def test_what_is_not_defined_is_a_dash():
    found = cmp.compare(series(np.ones(50)), series(wave(5, 50)))
    rows = [" ".join(line.split()) for line in cmp.as_table(cmp.as_document(found)).split("\n")]
    assert rows[:3] == ["similarity ρ –", "best lag –", "ρ at lag 0 –"]
    assert rows[5:7] == ["slope B over A –", "independent samples –"]


@pytest.mark.parametrize("size", [11, 12])
def test_as_many_lags_as_the_shorter_series_has_are_too_many(size):
    found = cmp.compare(series(wave(2, 40)), series(wave(2, 40)[:size]), max_lag=size - 1)
    assert found.max_lag == size - 1 and len(found.rho_at_lag) == 2 * size - 1
    with pytest.raises(CastError, match=f"the shorter series has {size}"):
        cmp.compare(series(wave(2, 40)), series(wave(2, 40)[:size]), max_lag=size)
