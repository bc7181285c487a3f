// SPDX-License-Identifier: GPL-3.0-or-later
// The kernels of the tracer for Python, without GNU Radio: scenario/create/images.py and fields.py,
// twin/places/passer.py and diagnose/places/bending.py, likelihood.py, scan.py, tracks.py,
// passages.py have the same in NumPy.
#include "../numpy_layout.h"
#include "tracing/body.h"
#include "tracing/edges.h"
#include "tracing/fields.h"
#include "tracing/grids.h"
#include "tracing/maps.h"
#include "tracing/mesh.h"
#include "tracing/unknowns.h"
#include <algorithm>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>
#include <stdexcept>
#include <string>

namespace py = pybind11;
using namespace gr::cast::tracing;

namespace
{

template <typename T> using array = py::array_t<T, py::array::c_style | py::array::forcecast>;

// The rows of an array whose last axes are `per` numbers.
template <typename T> size_t rows(const array<T>& values, size_t per, const char* name)
{
    const auto size = size_t(values.size());
    if (per ? size % per != 0 : size != 0)
        throw std::invalid_argument(std::string(name) + ": got " + std::to_string(size) +
                                    " numbers, rows have " + std::to_string(per));
    return per ? size / per : 0;
}

template <typename T> void expect(const array<T>& values, size_t wanted, const char* name)
{
    if (size_t(values.size()) != wanted)
        throw std::invalid_argument(std::string(name) + ": got " + std::to_string(values.size()) +
                                    " numbers, needs " + std::to_string(wanted));
}

void expect_below(const array<int64_t>& values, int64_t least, size_t end, const char* name)
{
    for (py::ssize_t i = 0; i < values.size(); i++)
        if (values.data()[i] < least || values.data()[i] >= int64_t(end))
            throw std::out_of_range(
                std::string(name) + ": got " + std::to_string(values.data()[i]) + ", needs " +
                std::to_string(least) + " to " + std::to_string(int64_t(end) - 1));
}

const vec* vectors(const array<double>& values)
{
    return reinterpret_cast<const vec*>(values.data());
}

template <typename T> std::vector<T> copied(const array<T>& values)
{
    return {values.data(), values.data() + values.size()};
}

std::vector<vec> copied_vectors(const array<double>& values)
{
    return {vectors(values), vectors(values) + values.size() / 3};
}

template <typename T> array<T> given(const std::vector<T>& values)
{
    return array<T>(py::ssize_t(values.size()), values.data());
}

py::tuple given(const path_list& found, unsigned depth)
{
    array<int64_t> faces = given(found.faces);
    return py::make_tuple(
        given(found.pair), faces.reshape({py::ssize_t(found.pair.size()), py::ssize_t(depth)}),
        given(found.crossing_path), given(found.crossing_leg), given(found.crossing_face));
}

mesh make_mesh(const array<double>& normal, const array<double>& level_m, const array<bool>& sided,
               const array<int64_t>& start, const array<double>& triangles_m)
{
    const size_t faces = rows(normal, 3, "normal"), triangles = rows(triangles_m, 9, "triangles_m");
    expect(level_m, faces, "level_m");
    expect(sided, faces, "sided");
    expect(start, faces + 1, "start");
    expect_below(start, 0, triangles + 1, "start");
    return mesh(copied_vectors(normal), copied(level_m), {sided.data(), sided.data() + faces},
                copied(start), copied_vectors(triangles_m));
}

size_t pairs_of(const array<double>& tx_m, const array<double>& rx_m)
{
    const size_t pairs = rows(tx_m, 3, "tx_m");
    expect(rx_m, 3 * pairs, "rx_m");
    return pairs;
}

py::tuple search(const mesh& faces, const array<double>& tx_m, const array<double>& rx_m,
                 unsigned depth, py::object among)
{
    const size_t pairs = pairs_of(tx_m, rx_m);
    if (among.is_none())
        return given(faces.search(vectors(tx_m), vectors(rx_m), pairs, depth, nullptr), depth);
    const auto wanted = among.cast<array<bool>>();
    expect(wanted, faces.size(), "among");
    const auto* mask = reinterpret_cast<const uint8_t*>(wanted.data());
    return given(faces.search(vectors(tx_m), vectors(rx_m), pairs, depth, mask), depth);
}

py::tuple search_again(const mesh& faces, const array<int64_t>& pair, const array<int64_t>& met,
                       const array<int64_t>& crossing_path, const array<int64_t>& crossing_leg,
                       const array<int64_t>& crossing_face, const array<double>& tx_m,
                       const array<double>& rx_m, unsigned depth, const array<bool>& changed)
{
    const size_t pairs = pairs_of(tx_m, rx_m);
    expect(met, size_t(pair.size()) * depth, "faces");
    expect(changed, faces.size(), "changed");
    expect(crossing_leg, size_t(crossing_path.size()), "crossing_leg");
    expect(crossing_face, size_t(crossing_path.size()), "crossing_face");
    expect_below(pair, 0, pairs, "pair");
    expect_below(met, -1, faces.size(), "faces");
    expect_below(crossing_face, 0, faces.size(), "crossing_face");
    const path_list known{copied(pair), copied(met), copied(crossing_path), copied(crossing_leg),
                          copied(crossing_face)};
    const auto* mask = reinterpret_cast<const uint8_t*>(changed.data());
    return given(faces.search_again(known, vectors(tx_m), vectors(rx_m), pairs, depth, mask),
                 depth);
}

py::tuple optics(const mesh& faces, const array<int64_t>& met, const array<double>& tx_m,
                 const array<double>& rx_m)
{
    const size_t paths = pairs_of(tx_m, rx_m);
    if (met.ndim() != 2 || size_t(met.shape(0)) != paths)
        throw std::invalid_argument("met: needs one row of faces for each path");
    expect_below(met, -1, faces.size(), "met");
    const auto depth = unsigned(met.shape(1));
    array<double> points_m({py::ssize_t(paths), py::ssize_t(depth + 2), py::ssize_t(3)});
    array<double> direction({py::ssize_t(paths), py::ssize_t(depth + 1), py::ssize_t(3)});
    array<double> length_m{py::ssize_t(paths)};
    auto* point = reinterpret_cast<vec*>(points_m.mutable_data());
    auto* along = reinterpret_cast<vec*>(direction.mutable_data());
    for (size_t path = 0; path < paths; path++, point += depth + 2, along += depth + 1) {
        const int64_t* row = met.data() + path * depth;
        faces.unfold(row, depth, vectors(tx_m)[path], vectors(rx_m)[path], point);
        double whole_m = 0;
        for (unsigned leg = 0; leg <= depth; leg++) {
            const vec way_m = point[leg + 1] - point[leg];
            const double leg_m = norm(way_m);
            whole_m += leg_m;
            along[leg] =
                leg && row[leg - 1] < 0 ? along[leg - 1] : 1 / std::max(leg_m, 1e-12) * way_m;
        }
        length_m.mutable_data()[path] = whole_m;
    }
    return py::make_tuple(points_m, direction, length_m);
}

py::tuple crossings(const mesh& faces, const array<double>& points_m, const array<int64_t>& met,
                    py::object among)
{
    if (met.ndim() != 2)
        throw std::invalid_argument("met: needs one row of faces for each path");
    const auto paths = size_t(met.shape(0));
    const auto depth = unsigned(met.shape(1));
    expect(points_m, 3 * paths * (depth + 2), "points");
    const auto wanted = among.is_none() ? array<bool>() : among.cast<array<bool>>();
    if (!among.is_none())
        expect(wanted, faces.size(), "among");
    const auto found = faces.crossings(
        vectors(points_m), met.data(), paths, depth,
        among.is_none() ? nullptr : reinterpret_cast<const uint8_t*>(wanted.data()));
    return py::make_tuple(given(found.path), given(found.leg), given(found.face),
                          given(found.share));
}

array<double> far_fields(const array<int64_t>& shape, const array<double>& rotation,
                         const array<int64_t>& antenna, const array<double>& direction)
{
    const size_t count = rows(direction, 3, "direction"), antennas = size_t(shape.size());
    expect(rotation, 9 * antennas, "rotation");
    expect(antenna, count, "antenna");
    expect_below(shape, 0, 4, "shape");
    expect_below(antenna, 0, antennas, "antenna");
    array<double> out({py::ssize_t(count), py::ssize_t(3)});
    auto* field = reinterpret_cast<vec*>(out.mutable_data());
    for (size_t i = 0; i < count; i++) {
        const int64_t one = antenna.data()[i];
        field[i] = far_field(pattern(shape.data()[one]), vectors(rotation) + 3 * one,
                             vectors(direction)[i]);
    }
    return out;
}

array<complex> path_gains(const array<double>& normal, const array<int64_t>& owner,
                          const array<int64_t>& met, const array<int64_t>& crossing_path,
                          const array<int64_t>& crossing_leg, const array<int64_t>& crossing_face,
                          const array<double>& direction, const array<double>& length_m,
                          const array<complex>& permittivity, const array<double>& thickness_m,
                          const array<double>& height_rms_m, const array<double>& scattering,
                          const array<bool>& present, const array<double>& start,
                          const array<double>& end, double wavelength_m)
{
    const auto count = size_t(length_m.size()), objects = size_t(permittivity.size()),
               faces = size_t(owner.size());
    if (met.ndim() != 2 || size_t(met.shape(0)) != count)
        throw std::invalid_argument("faces: needs one row for each path");
    const auto depth = unsigned(met.shape(1));
    expect(normal, 3 * faces, "normal");
    expect_below(owner, 0, objects, "owner");
    expect_below(met, -1, faces, "faces");
    expect_below(crossing_face, 0, faces, "crossing_face");
    expect(crossing_leg, size_t(crossing_path.size()), "crossing_leg");
    expect(crossing_face, size_t(crossing_path.size()), "crossing_face");
    expect(direction, 3 * count * (depth + 1), "direction");
    expect(thickness_m, objects, "thickness_m");
    expect(height_rms_m, objects, "height_rms_m");
    expect(scattering, objects, "scattering");
    expect(present, objects, "present");
    expect(start, 3 * count, "start");
    expect(end, 3 * count, "end");
    array<complex> out{py::ssize_t(count)};
    gains({count, depth, met.data(), size_t(crossing_path.size()), crossing_path.data(),
           crossing_leg.data(), crossing_face.data(), vectors(direction), length_m.data(),
           vectors(start), vectors(end)},
          vectors(normal), owner.data(),
          {permittivity.data(), thickness_m.data(), height_rms_m.data(), scattering.data(),
           reinterpret_cast<const uint8_t*>(present.data())},
          wavelength_m, out.mutable_data());
    return out;
}

array<complex> path_sums(const array<int64_t>& instant, const array<complex>& gain,
                         const array<double>& length_m, size_t instants, double begin_hz,
                         double step_hz, size_t steps)
{
    const auto count = size_t(instant.size());
    expect(gain, count, "gain");
    expect(length_m, count, "length_m");
    expect_below(instant, 0, instants, "instant");
    array<complex> out({py::ssize_t(instants), py::ssize_t(steps)});
    std::fill_n(out.mutable_data(), instants * steps, complex(0));
    summed(count, instant.data(), gain.data(), length_m.data(), begin_hz, step_hz, steps,
           out.mutable_data());
    return out;
}

array<bool> shaded_paths(double radius_m, double height_m, const array<double>& foot_m,
                         const array<double>& points_m)
{
    if (foot_m.ndim() != 3 || points_m.ndim() != 4 || foot_m.shape(1) != points_m.shape(0) ||
        foot_m.shape(2) != 3 || points_m.shape(3) != 3)
        throw std::invalid_argument(
            "shaded: needs feet (places, rows, 3) and paths (rows, paths, points, 3)");
    const auto places = foot_m.shape(0), rows = foot_m.shape(1), paths = points_m.shape(1);
    array<bool> out({places, rows, paths});
    shaded({radius_m, height_m}, vectors(foot_m), size_t(places), size_t(rows), vectors(points_m),
           size_t(paths), size_t(points_m.shape(2)),
           reinterpret_cast<uint8_t*>(out.mutable_data()));
    return out;
}

array<double> summed_maps(const array<double>& maps, const array<int64_t>& moved)
{
    if (maps.ndim() != 3 || moved.ndim() != 3 || moved.shape(1) != maps.shape(0) ||
        moved.shape(2) != 2)
        throw std::invalid_argument(
            "summed_along: needs maps (maps, wide, deep) and moves (ways, maps, 2)");
    array<double> out({moved.shape(0), maps.shape(1), maps.shape(2)});
    summed_along(maps.data(), size_t(maps.shape(0)), size_t(maps.shape(1)), size_t(maps.shape(2)),
                 moved.data(), size_t(moved.shape(0)), out.mutable_data());
    return out;
}

array<double> sums_along(const array<float>& maps, double begin_m, double step_m,
                         const array<double>& after_s, const array<int64_t>& instant,
                         const array<double>& at_m, const array<double>& turn)
{
    const auto instants = size_t(after_s.size());
    if (maps.ndim() != 4 || size_t(maps.shape(1)) != instants || maps.shape(2) != maps.shape(3))
        throw std::invalid_argument("along: needs a square map of each kind at each instant");
    expect_below(instant, 0, instants, "instant");
    const size_t lines = rows(at_m, 2, "at_m");
    expect(turn, 2 * lines, "turn");
    array<double> out({maps.shape(0), py::ssize_t(lines)});
    along({maps.data(), size_t(maps.shape(0)), instants, size_t(maps.shape(2)), begin_m, step_m,
           after_s.data()},
          instant.data(), size_t(instant.size()), at_m.data(), turn.data(), lines,
          out.mutable_data());
    return out;
}

array<float> likelier_maps(double power, double count, double before, bool is_free,
                           const array<double>& own, const array<complex>& shared,
                           const array<complex>& heard, const array<float>& common,
                           const array<float>& loud, const array<int64_t>& kind,
                           const array<double>& roots)
{
    const auto cells = size_t(kind.size()), kinds = size_t(own.size());
    expect(shared, kinds, "shared");
    expect(heard, cells, "heard");
    expect(common, kinds * cells, "common");
    expect(loud, cells, "loud");
    expect_below(kind, 0, std::min(kinds, size_t(256)), "kind");
    std::vector<float> real(cells), imag(cells);
    std::vector<uint8_t> which(cells);
    for (size_t i = 0; i < cells; i++) {
        real[i] = float(heard.data()[i].real());
        imag[i] = float(heard.data()[i].imag());
        which[i] = uint8_t(kind.data()[i]);
    }
    array<float> out({roots.size(), py::ssize_t(cells)});
    likelier({power, count, before, is_free, own.data(), shared.data()},
             {real.data(), imag.data(), common.data(), loud.data()}, which.data(), cells,
             roots.data(), size_t(roots.size()), out.mutable_data());
    return out;
}

array<float> turned_fields(const array<complex>& field, const array<double>& turned,
                           const array<double>& at)
{
    if (field.ndim() != 2 || field.shape(0) != field.shape(1) || field.shape(0) < 2)
        throw std::invalid_argument("turned_between: needs fields at knots, two or more each way");
    const auto knots = size_t(field.shape(0)), cells = size_t(at.size());
    expect(turned, knots * knots, "turned");
    for (size_t i = 0; i < cells; i++)
        if (!(at.data()[i] > -1 && at.data()[i] < double(knots)))
            throw std::out_of_range("at: got a place beyond all knots");
    array<float> out({py::ssize_t(cells), py::ssize_t(cells)});
    turned_between(field.data(), turned.data(), knots, at.data(), cells, out.mutable_data());
    return out;
}

// In place, so nothing is converted: numbers of another kind are refused.
double loosen_edges(const array<complex>& field, const array<double>& weight,
                    py::array_t<complex, py::array::c_style>& model,
                    py::array_t<complex, py::array::c_style>& residual)
{
    const auto count = size_t(weight.size());
    const size_t edges = rows(field, count, "field");
    if (size_t(model.size()) != count || size_t(residual.size()) != count)
        throw std::invalid_argument("loosen: model and residual need as many numbers as weight");
    return loosen(field.data(), edges, count, weight.data(), model.mutable_data(),
                  residual.mutable_data());
}

turning turning_of(const array<complex>& path, const array<double>& rate,
                   const array<complex>& rest, const array<complex>& heard, bool is_free,
                   size_t axes)
{
    const auto tones = size_t(rest.size());
    const size_t paths = rows(path, tones, "path");
    expect(rate, axes * paths * tones, "rate");
    expect(heard, tones, "heard");
    return {path.data(), rate.data(), rest.data(), heard.data(), paths, tones, is_free};
}

// (power, along), each third x first x second.
py::tuple scanned(const array<complex>& path, const array<double>& rate, const array<complex>& rest,
                  const array<complex>& heard, bool is_free,
                  const std::vector<std::vector<double>>& axes)
{
    if (axes.size() != 2 && axes.size() != 3)
        throw std::invalid_argument("scanned: got " + std::to_string(axes.size()) +
                                    " axes, needs 2 or 3");
    const turning one = turning_of(path, rate, rest, heard, is_free, axes.size());
    const std::vector<size_t> shape{axes.size() > 2 ? axes[2].size() : 1, axes[0].size(),
                                    axes[1].size()};
    array<float> power(shape), along(shape);
    over_grid(one, axes, power.mutable_data(), along.mutable_data());
    return py::make_tuple(power, along);
}

// (top, side, left), one each of places (n, axes).
py::tuple stepped(const array<complex>& path, const array<double>& rate, const array<complex>& rest,
                  const array<complex>& heard, bool is_free, const array<double>& places,
                  double count)
{
    if (places.ndim() != 2)
        throw std::invalid_argument("stepped: got places of " + std::to_string(places.ndim()) +
                                    " axes, needs 2");
    const py::ssize_t n = places.shape(0), axes = places.shape(1);
    const turning one = turning_of(path, rate, rest, heard, is_free, size_t(axes));
    array<double> top({n, axes, axes}), side({n, axes}), left(n);
    std::fill_n(top.mutable_data(), top.size(), 0.0);
    std::fill_n(side.mutable_data(), side.size(), 0.0);
    steps_from(one, count, places.data(), size_t(n), size_t(axes), top.mutable_data(),
               side.mutable_data(), left.mutable_data());
    return py::make_tuple(top, side, left);
}

sounding sounding_of(const array<complex>& h, const array<complex>& y, const array<double>& weight,
                     const array<double>& omega)
{
    if (h.ndim() != 3 || h.shape(2) != omega.size())
        throw std::invalid_argument("model: needs links x instants x as many tones as omega");
    expect(y, size_t(h.size()), "y");
    expect(weight, size_t(h.size()), "weight");
    return {size_t(h.shape(0)), size_t(h.shape(1)), size_t(h.shape(2)),
            y.data(),           weight.data(),      omega.data()};
}

// (cross, moments), of all instants `together` or of each.
py::tuple crossed(const array<complex>& h, const array<complex>& y, const array<double>& weight,
                  const array<double>& omega, bool together)
{
    const sounding heard = sounding_of(h, y, weight, omega);
    const py::ssize_t instants = together ? 1 : h.shape(1);
    array<complex> cross({h.shape(0), instants, h.shape(2)});
    array<double> moments({h.shape(0), instants, py::ssize_t(3)});
    cross_with(heard, h.data(), together, cross.mutable_data(), moments.mutable_data());
    return py::make_tuple(cross, moments);
}

// (links,) numbers of a grid of `size` delays.
array<int64_t> coarsely_late(const array<complex>& cross, size_t size, double first,
                             bool is_phase_free)
{
    if (cross.ndim() != 3)
        throw std::invalid_argument("cross: needs links x instants x tones");
    if (size < size_t(cross.shape(2)) || size < 2 || (size & (size - 1)))
        throw std::invalid_argument("late: got a grid of " + std::to_string(size) +
                                    ", needs a power of two and no less than there are tones");
    array<int64_t> best(cross.shape(0));
    coarse_delays(cross.data(), size_t(cross.shape(0)), size_t(cross.shape(1)),
                  size_t(cross.shape(2)), size, first, is_phase_free, best.mutable_data());
    return best;
}

shared shared_of(const std::string& name)
{
    for (const auto& [known, kind] :
         {std::pair("none", shared::none), std::pair("common", shared::common),
          std::pair("node", shared::node), std::pair("link", shared::link)})
        if (name == known)
            return kind;
    throw std::invalid_argument("settled: got " + name + ", needs none, common, node or link");
}

// (delay_s, log_gain, sums, phase).
py::tuple settled(const array<complex>& cross, const array<double>& moments,
                  const array<double>& omega, const array<double>& delay_s,
                  const array<int64_t>& ends, bool is_phase_free, const std::string& gain,
                  const std::string& delay, size_t rounds)
{
    if (cross.ndim() != 3 || cross.shape(2) != omega.size())
        throw std::invalid_argument("cross: needs links x instants x as many tones as omega");
    const py::ssize_t links = cross.shape(0), instants = cross.shape(1);
    expect(moments, size_t(links * instants) * 3, "moments");
    expect(delay_s, size_t(links), "delay_s");
    expect(ends, size_t(links) * 2, "ends");
    const size_t nodes =
        links ? size_t(*std::max_element(ends.data(), ends.data() + 2 * links)) + 1 : 0;
    expect_below(ends, 0, 2 * size_t(links), "ends");
    array<double> late(links), log_gain(links);
    std::copy_n(delay_s.data(), links, late.mutable_data());
    array<complex> sums({links, instants}), phase({links, instants});
    settle({size_t(links), size_t(instants), size_t(omega.size()), cross.data(), moments.data(),
            omega.data(), ends.data(), nodes, is_phase_free, shared_of(gain), shared_of(delay)},
           rounds, late.mutable_data(), log_gain.mutable_data(), sums.mutable_data(),
           phase.mutable_data());
    return py::make_tuple(late, log_gain, sums, phase);
}

// (model, residual, energy) of a factor (links, 1 or instants, 1 or tones).
py::tuple left_by(const array<complex>& h, const array<complex>& factor, const array<complex>& y,
                  const array<double>& weight, const array<double>& omega)
{
    const sounding heard = sounding_of(h, y, weight, omega);
    if (factor.ndim() != 3 || factor.shape(0) != h.shape(0) ||
        (factor.shape(1) != 1 && factor.shape(1) != h.shape(1)) ||
        (factor.shape(2) != 1 && factor.shape(2) != h.shape(2)))
        throw std::invalid_argument("factor: needs links x 1 or instants x 1 or tones");
    array<complex> model({h.shape(0), h.shape(1), h.shape(2)}),
        residual({h.shape(0), h.shape(1), h.shape(2)});
    const double energy = leave(heard, h.data(), factor.data(), factor.shape(1) > 1,
                                factor.shape(2) > 1, model.mutable_data(), residual.mutable_data());
    return py::make_tuple(model, residual, energy);
}

} // namespace

PYBIND11_MODULE(tracing, m)
{
    expect_known_numpy();
    py::class_<mesh>(m, "Mesh")
        .def(py::init(&make_mesh), py::arg("normal"), py::arg("level_m"), py::arg("sided"),
             py::arg("start"), py::arg("triangles_m"))
        .def("search", &search, py::arg("tx_m"), py::arg("rx_m"), py::arg("depth"),
             py::arg("among") = py::none())
        .def("search_again", &search_again)
        .def("crossings", &crossings, py::arg("points"), py::arg("met"),
             py::arg("among") = py::none())
        .def("optics", &optics, py::arg("met"), py::arg("tx_m"), py::arg("rx_m"));
    m.def("far_fields", &far_fields, py::arg("shape"), py::arg("rotation"), py::arg("antenna"),
          py::arg("direction"));
    m.def("gains", &path_gains);
    m.def("summed", &path_sums);
    m.def("shaded", &shaded_paths, py::arg("radius_m"), py::arg("height_m"), py::arg("foot_m"),
          py::arg("points_m"));
    m.def("summed_along", &summed_maps, py::arg("maps"), py::arg("moved"));
    m.def("along", &sums_along);
    m.def("likelier", &likelier_maps);
    m.def("loosen", &loosen_edges, py::arg("field"), py::arg("weight"),
          py::arg("model").noconvert(), py::arg("residual").noconvert());
    m.def("scanned", &scanned, py::arg("path"), py::arg("rate"), py::arg("rest"), py::arg("heard"),
          py::arg("is_free"), py::arg("axes"));
    m.def("stepped", &stepped, py::arg("path"), py::arg("rate"), py::arg("rest"), py::arg("heard"),
          py::arg("is_free"), py::arg("places"), py::arg("count"));
    m.def("crossed", &crossed, py::arg("h"), py::arg("y"), py::arg("weight"), py::arg("omega"),
          py::arg("together"));
    m.def("late", &coarsely_late, py::arg("cross"), py::arg("size"), py::arg("first"),
          py::arg("is_phase_free"));
    m.def("settled", &settled, py::arg("cross"), py::arg("moments"), py::arg("omega"),
          py::arg("delay_s"), py::arg("ends"), py::arg("is_phase_free"), py::arg("gain"),
          py::arg("delay"), py::arg("rounds"));
    m.def("left_by", &left_by, py::arg("h"), py::arg("factor"), py::arg("y"), py::arg("weight"),
          py::arg("omega"));
    m.def("turned_between", &turned_fields, py::arg("field"), py::arg("turned"), py::arg("at"));
}
