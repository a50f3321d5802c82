#include "dfr/kernel/time_varying_support.h"

#include <pybind11/pybind11.h>
#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <filesystem>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "arrays.h"
#include "dfr/core/contract.h"
#include "dfr/kernel/onnx_export.h"

namespace py = pybind11;

namespace dfr::python {
namespace {

using kernel::OneClassSvm;
using kernel::TimeVaryingSupport;

TimeVaryingSupport FitSupport(const Arrays& arrays, const py::object& nu, const py::object& gamma,
                              const py::object& tolerance, const py::object& num_steps,
                              const py::object& pooled, const py::object& threads,
                              const std::optional<Array>& weights) {
  const std::vector<Array>& demonstrations = arrays.each;
  std::vector<MatrixView> views;
  for (std::size_t i = 0; i < demonstrations.size(); ++i) {
    DFR_THROW_UNLESS(demonstrations[i].ndim() == 2,
                     "demonstration " << i << " must have 2 dimensions (states x entries), not "
                                      << demonstrations[i].ndim());
    views.push_back(Rows(demonstrations[i], "a demonstration"));
  }
  kernel::TimeVaryingSupportOptions options;
  options.svm.nu = RealOption(nu, "nu");
  options.svm.gamma = RealOption(gamma, "gamma");
  options.svm.tolerance = RealOption(tolerance, "tolerance");
  options.num_steps = WholeOption(num_steps, "num_steps");
  options.pooled = FlagOption(pooled, "pooled");
  options.threads = WholeOption(threads, "threads");
  if (weights) options.svm.weights = Entries(*weights);
  Interruptible interruptible;
  options.svm.progress = [&](const kernel::FitProgress&) { return interruptible.GoOn(); };
  auto support = [&] {
    const Unlocked unlocked;
    return TimeVaryingSupport::Fit(std::span<const MatrixView>(views), options);
  }();
  interruptible.Throw();
  return support;
}

void CheckWidth(const TimeVaryingSupport& support, Eigen::Index width) {
  DFR_THROW_UNLESS(width == support.state_dim(),
                   "states of " << width << " entries; the support has " << support.state_dim());
}

py::object DecisionAt(const TimeVaryingSupport& support, int t, const Array& x) {
  const MatrixView rows = Rows(x, "x");
  CheckWidth(support, rows.cols());
  if (x.ndim() == 1) return py::float_(support.Decision(t, Entries(x)));
  py::array_t<double> g = NewVector(rows.rows());
  const std::span<double> values = Entries(g);
  {
    const Unlocked unlocked;
    support.at(t).DecisionBatch(rows, values);
  }
  return g;
}

py::object SupportDecision(const TimeVaryingSupport& support, const py::object& time,
                           const Array& x) {
  const auto t = Steps(time);
  if (t.ndim() == 0) return DecisionAt(support, NearestInt(t.data()[0]), x);
  DFR_THROW_UNLESS(x.ndim() == 2 && t.ndim() == 1 && t.shape(0) == x.shape(0),
                   "with an array of time steps, x must have one row for each of them");
  const MatrixView rows = Rows(x, "x");
  CheckWidth(support, rows.cols());
  const std::int64_t* steps = t.data();
  py::array_t<double> g = NewVector(rows.rows());
  const std::span<double> values = Entries(g);
  {
    const Unlocked unlocked;
    for (Eigen::Index i = 0; i < rows.rows(); ++i) {
      values[static_cast<std::size_t>(i)] = support.Decision(
          NearestInt(steps[i]), {rows.row(i).data(), static_cast<std::size_t>(rows.cols())});
    }
  }
  return g;
}

py::tuple SupportGradient(const TimeVaryingSupport& support, const py::object& time,
                          const Array& x) {
  const std::int64_t step = WholeStep(time);
  CheckStep(step);
  const int t = NearestInt(step);
  DFR_THROW_UNLESS(x.ndim() == 1, "x must be one state of " << support.state_dim() << " entries");
  CheckWidth(support, x.size());
  py::array_t<double> gradient = NewVector(support.state_dim());
  const double g = support.Gradient(t, Entries(x), Entries(gradient));
  return py::make_tuple(g, std::move(gradient));
}

}  // namespace

void AddTimeVaryingSupport(py::module_& module) {
  py::class_<TimeVaryingSupport> support_class(
      module, "TimeVaryingSupport", R"(The support of the demonstrated states at each time step.

One `SupportEstimate` g_t per time step t, fitted to the states of all demonstrations at t.
A demonstration that ends early contributes its last state from then on. Immutable: threads may
share a support.

Parameters
----------
estimates : sequence of SupportEstimate
    g_0 first, all of the same width.

Attributes
----------
state_dim : int
num_steps : int
    Number of estimates. Later time steps use the last estimate. Negative time steps raise ValueError.
)");
  PickleBy(
      support_class,
      [](const py::object& self) {
        const auto& support = self.cast<const TimeVaryingSupport&>();
        py::list estimates;
        for (int t = 0; t < support.num_steps(); ++t) estimates.append(GetState(support.at(t)));
        return py::make_tuple(estimates);
      },
      [](const py::tuple& state) {
        std::vector<OneClassSvm> estimates;
        for (const py::handle estimate : state[0].cast<py::list>()) {
          estimates.push_back(FromState(estimate.cast<py::tuple>()));
        }
        return TimeVaryingSupport(std::move(estimates));
      });
  support_class.def(py::init<std::vector<OneClassSvm>>(), py::arg("estimates"))
      .def_static("fit", &FitSupport, py::arg("demonstrations"), py::kw_only(),
                  py::arg("nu") = 0.05, py::arg("gamma") = 5.0, py::arg("tolerance") = 1e-4,
                  py::arg("num_steps") = 0, py::arg("pooled") = false, py::arg("threads") = 0,
                  py::arg("weights") = py::none(), R"(Fit one estimate per time step.

Parameters
----------
demonstrations : sequence of array_like of shape (n_states_i, state_dim)
    One array per demonstration, rows in order of time. Read in place if C-contiguous float64.
nu, gamma, tolerance : float
    As in `SupportEstimate.fit`, the same for every time step.
num_steps : int
    Number of time steps with an estimate; 0: the number of states of the longest demonstration.
pooled : bool
    Fit a single estimate to the states of all time steps.
threads : int
    Number of threads; 0: one per core. Does not change the estimates.
weights : array_like of shape (n_demonstrations,), optional
    Weight of each demonstration.

Raises
------
ValueError
    If a demonstration, state or option is invalid; the message names it.
)")
      .def_static(
          "load",
          [](const std::filesystem::path& path) {
            RequireFile(path);
            const Unlocked unlocked;
            return TimeVaryingSupport::Load(path);
          },
          py::arg("path"), R"(Read a file written by `save` or the C++ library.

Raises
------
FileNotFoundError
    If the file does not exist.
RuntimeError
    If the file is invalid; the message gives its name and the reason.
)")
      .def(
          "save",
          [](const TimeVaryingSupport& support, const std::filesystem::path& path) {
            const Unlocked unlocked;
            support.Save(path);
          },
          py::arg("path"), "Write all estimates to a file, exactly.")
      .def(
          "export_onnx",
          [](const TimeVaryingSupport& support, const std::filesystem::path& path) {
            const Unlocked unlocked;
            kernel::ExportOnnx(support, path);
          },
          py::arg("path"), R"(Write g_t as an ONNX file in double.

Its inputs are t (rows, int64) and x (rows, state_dim), its output g (rows).
)")
      .def("decision", &SupportDecision, py::arg("t"), py::arg("x"),
           R"(Return g_t, positive inside the support.

Parameters
----------
t : int or array_like of shape (n,)
    One time step, or one for each row.
x : array_like of shape (state_dim,) or (n, state_dim)
    Read in place if C-contiguous float64. A state with a non-finite entry gives -inf.

Returns
-------
float or ndarray of shape (n,)
)")
      .def("gradient", &SupportGradient, py::arg("t"), py::arg("x"),
           R"(Return g_t and its derivative at one state.

Returns
-------
g : float
gradient : ndarray of shape (state_dim,)
)")
      .def(
          "at",
          [](const TimeVaryingSupport& support, const py::object& step) {
            const std::int64_t t = WholeStep(step);
            CheckStep(t);
            return support.at(NearestInt(t));
          },
          py::arg("t"),
          "The SupportEstimate of time step t; later time steps use the last estimate.")
      .def(
          "lipschitz_bound",
          [](const TimeVaryingSupport& support, const py::object& step) {
            const std::int64_t t = WholeStep(step);
            CheckStep(t);
            return support.at(NearestInt(t)).lipschitz_bound();
          },
          py::arg("t"), "L with |g_t(x) - g_t(y)| <= L |x - y|.")
      .def_property_readonly("state_dim", &TimeVaryingSupport::state_dim)
      .def_property_readonly("num_steps", &TimeVaryingSupport::num_steps)
      .def("__repr__", [](const TimeVaryingSupport& support) {
        return "<dfr.TimeVaryingSupport: " + std::to_string(support.num_steps()) +
               " time steps, states of " + std::to_string(support.state_dim()) + " entries>";
      });
}

}  // namespace dfr::python
