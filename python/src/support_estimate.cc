#include <pybind11/pybind11.h>
#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <cmath>
#include <filesystem>
#include <optional>
#include <string>
#include <utility>

#include "arrays.h"
#include "dfr/core/contract.h"
#include "dfr/kernel/one_class_svm.h"
#include "dfr/kernel/onnx_export.h"

namespace py = pybind11;

namespace dfr::python {
namespace {

using kernel::FitSummary;
using kernel::OneClassSvm;
using kernel::OneClassSvmOptions;

const char* Name(FitSummary::Reason reason) {
  switch (reason) {
    case FitSummary::Reason::kConverged:
      return "converged";
    case FitSummary::Reason::kMaxIterations:
      return "max_iterations";
    case FitSummary::Reason::kInterrupted:
      return "interrupted";
    case FitSummary::Reason::kStalled:
      return "stalled";
  }
  return "unknown";
}

std::pair<OneClassSvm, FitSummary> FitEstimate(const Array& samples, const py::object& nu,
                                               const py::object& gamma, const py::object& tolerance,
                                               const py::object& max_iterations,
                                               const py::object& memory_mib,
                                               const std::optional<Array>& weights,
                                               const py::object& threads) {
  OneClassSvmOptions options{
      .nu = RealOption(nu, "nu"),
      .gamma = RealOption(gamma, "gamma"),
      .tolerance = RealOption(tolerance, "tolerance"),
      .max_iterations = Option<std::int64_t>(max_iterations, "max_iterations", "a whole number"),
      .memory_mib = RealOption(memory_mib, "memory_mib"),
      .threads = WholeOption(threads, "threads")};
  if (weights) options.weights = Entries(*weights);
  Interruptible interruptible;
  options.progress = [&](const kernel::FitProgress&) { return interruptible.GoOn(); };
  FitSummary summary;
  const MatrixView rows = Rows(samples, "samples");
  auto svm = [&] {
    const Unlocked unlocked;
    return OneClassSvm::Fit(rows, options, &summary);
  }();
  interruptible.Throw();
  return {std::move(svm), std::move(summary)};
}

// Returns g as scikit-learn does. On the boundary, the sum and rho cancel, and only rounding errors
// remain: another order of the same samples could change the sign.
double InLibsvmScale(const OneClassSvm& svm, double g) {
  constexpr double kAccuracy = 1e-12;  // error of sum and rho, see GaussianSum()
  return std::abs(g) <= kAccuracy * svm.rho() ? 0.0 : svm.libsvm_scale() * g;
}

// Returns g of one state as a number, and of several states as an array.
py::object EstimateDecision(const OneClassSvm& svm, const Array& x, bool libsvm_scale) {
  const MatrixView rows = Rows(x, "x");
  DFR_THROW_UNLESS(rows.cols() == svm.state_dim(),
                   "states of " << rows.cols() << " entries; the estimate has " << svm.state_dim());
  if (x.ndim() == 1) {
    const double g = svm.Decision(Entries(x));
    return py::float_(libsvm_scale ? InLibsvmScale(svm, g) : g);
  }
  py::array_t<double> g = NewVector(rows.rows());
  const std::span<double> values = Entries(g);
  {
    const Unlocked unlocked;
    // Threads pay off from about a millisecond of work.
    constexpr double kMany = 1e6;
    const bool many = static_cast<double>(rows.rows()) * svm.num_support_vectors() > kMany;
    svm.DecisionBatch(rows, values, many ? 0 : 1);
    if (libsvm_scale) {
      for (double& value : values) value = InLibsvmScale(svm, value);
    }
  }
  return g;
}

void ExportOnnx(const OneClassSvm& svm, const std::filesystem::path& path, bool libsvm_scale) {
  const Unlocked unlocked;
  if (!libsvm_scale) return kernel::ExportOnnx(svm, path);
  core::OnnxGraph graph("one_class_svm");
  const std::string x = graph.Input("x", core::OnnxGraph::Type::kDouble, {-1, svm.state_dim()});
  const std::string g = kernel::AppendDecision(graph, svm, x);
  graph.Output(graph.Node("Mul", {g, graph.Constant(svm.libsvm_scale())}), "g",
               core::OnnxGraph::Type::kDouble, {-1});
  graph.Save(path);
}

py::tuple EstimateGradient(const OneClassSvm& svm, const Array& x) {
  DFR_THROW_UNLESS(x.ndim() == 1 && x.size() == svm.state_dim(),
                   "x must be one state of " << svm.state_dim() << " entries");
  py::array_t<double> gradient = NewVector(svm.state_dim());
  const double g = svm.Gradient(Entries(x), Entries(gradient));
  return py::make_tuple(g, std::move(gradient));
}

// Returns the position of the first nonfinite entry, or none.
std::optional<std::pair<Eigen::Index, Eigen::Index>> FindNonFinite(const Array& x) {
  const MatrixView rows = Rows(x, "x");
  const Unlocked unlocked;
  for (Eigen::Index i = 0; i < rows.rows(); ++i) {
    // A product of zero and a non-finite entry is NaN, and so is the sum.
    double sum = 0.0;
    for (Eigen::Index k = 0; k < rows.cols(); ++k) sum += 0.0 * rows(i, k);
    if (sum == 0.0) continue;
    for (Eigen::Index k = 0; k < rows.cols(); ++k) {
      if (!std::isfinite(rows(i, k))) return std::pair(i, k);
    }
  }
  return std::nullopt;
}

double Variance(const Array& x) {
  const MatrixView rows = Rows(x, "x");
  const Unlocked unlocked;
  const double mean = rows.mean();
  return (rows.array() - mean).square().mean();
}

}  // namespace

py::tuple GetState(const OneClassSvm& svm) {
  const py::object owner = py::cast(svm);
  return py::make_tuple(View(svm.support_vectors(), owner), View(svm.alpha(), owner), svm.gamma(),
                        svm.rho(), svm.libsvm_scale());
}

OneClassSvm FromState(const py::tuple& state) {
  DFR_THROW_UNLESS(state.size() == 5, "this is not a pickled SupportEstimate");
  const auto alpha = state[1].cast<Array>();
  return OneClassSvm::FromParts(Rows(state[0].cast<Array>(), "support_vectors"),
                                core::AsVector(Entries(alpha)), state[2].cast<double>(),
                                state[3].cast<double>(), state[4].cast<double>());
}

void AddSupportEstimate(py::module_& module) {
  py::class_<FitSummary> summary(module, "FitSummary", R"(Result and cost of a fit.

Attributes
----------
reason : str
    "converged", "max_iterations" (usable, with the error `kkt_gap`), or "stalled" (the tolerance is
    below the precision of doubles).
iterations : int
kkt_gap : float
    Largest violation of the optimality conditions, in LIBSVM's scale.
objective : float
    alpha' K alpha / 2, in LIBSVM's scale.
kernel_evaluations : int
seconds : float
alpha : ndarray of shape (n_samples,)
    Coefficient of every sample; they sum to 1.
)");
  summary.def_property_readonly("reason", [](const FitSummary& s) { return Name(s.reason); })
      .def_readonly("iterations", &FitSummary::iterations)
      .def_readonly("kkt_gap", &FitSummary::kkt_gap)
      .def_readonly("objective", &FitSummary::objective)
      .def_readonly("kernel_evaluations", &FitSummary::kernel_evaluations)
      .def_readonly("seconds", &FitSummary::seconds)
      .def_property_readonly("alpha", [](const py::object& self) {
        return View(self.cast<const FitSummary&>().alpha, self);
      });
  PickleBy(
      summary,
      [](const py::object& self) {
        const auto& s = self.cast<const FitSummary&>();
        return py::make_tuple(static_cast<int>(s.reason), s.iterations, s.kkt_gap, s.objective,
                              s.num_support_vectors, s.kernel_evaluations, s.seconds,
                              View(s.alpha, self));
      },
      [](const py::tuple& state) {
        DFR_THROW_UNLESS(state.size() == 8, "this is not a pickled FitSummary");
        const auto alpha = state[7].cast<Array>();
        return FitSummary{static_cast<FitSummary::Reason>(state[0].cast<int>()),
                          state[1].cast<std::int64_t>(),
                          state[2].cast<double>(),
                          state[3].cast<double>(),
                          state[4].cast<int>(),
                          state[5].cast<std::int64_t>(),
                          state[6].cast<double>(),
                          core::AsVector(Entries(alpha))};
      });

  py::class_<OneClassSvm> estimate(module, "SupportEstimate", R"(Support estimate of a sample cloud.

g(x) = sum_i alpha_i exp(-gamma |x - x_i|^2) - rho, positive inside. alpha sums to 1. Therefore g does
not grow with the number of samples; scikit-learn's and LIBSVM's decision values are `libsvm_scale`
times g. Immutable: threads may share an estimate.

Attributes
----------
state_dim : int
gamma, rho, libsvm_scale : float
lipschitz_bound : float
    L with \|g(x) - g(y)\| <= L \|x - y\|.
alpha : ndarray of shape (n_support_vectors,)
support_vectors : ndarray of shape (n_support_vectors, state_dim)
    Both are read-only views.
)");
  PickleBy(
      estimate, [](const py::object& self) { return GetState(self.cast<const OneClassSvm&>()); },
      &FromState);
  estimate
      .def_static("fit", &FitEstimate, py::arg("samples"), py::kw_only(), py::arg("nu") = 0.05,
                  py::arg("gamma") = 5.0, py::arg("tolerance") = 1e-4,
                  py::arg("max_iterations") = 0, py::arg("memory_mib") = 512.0,
                  py::arg("weights") = py::none(), py::arg("threads") = 0,
                  R"(Fit an estimate to samples.

Parameters
----------
samples : array_like of shape (n_samples, state_dim)
    Not converted if C-contiguous float64.
nu : float
    In (0, 1]: upper bound on the share of samples outside, lower bound on the share of support
    vectors.
gamma : float
    Parameter of the Gaussian kernel, in 1/unit^2.
tolerance : float
    Largest violation of the optimality conditions at which the fit stops, in LIBSVM's scale.
max_iterations : int
    Largest number of iterations; 0: no practical limit.
memory_mib : float
    Bound on the memory of the fit.
weights : array_like of shape (n_samples,), optional
    Weight of each sample.
threads : int
    Number of threads; 0: one per core. Does not change the estimate.

Returns
-------
estimate : SupportEstimate
summary : FitSummary

Raises
------
ValueError
    If a sample, weight or option is invalid; the message names it.
KeyboardInterrupt
    After Ctrl-C. Other threads run during a fit: it does not hold the interpreter's lock.
)")
      .def("decision", &EstimateDecision, py::arg("x"), py::kw_only(),
           py::arg("libsvm_scale") = false,
           R"(Return g of one state (a float) or of one state per row (an array).

Parameters
----------
x : array_like of shape (state_dim,) or (n, state_dim)
    Read in place if C-contiguous float64. A state with a non-finite entry gives -inf.
libsvm_scale : bool
    Multiply by `libsvm_scale`, as in scikit-learn and LIBSVM. Values below their accuracy of
    1e-12 rho are 0: a sample on the boundary is inside.
)")
      .def("gradient", &EstimateGradient, py::arg("x"), R"(Return g and its derivative at one state.

Returns
-------
g : float
gradient : ndarray of shape (state_dim,)
)")
      .def("export_onnx", &ExportOnnx, py::arg("path"), py::kw_only(),
           py::arg("libsvm_scale") = false,
           "Write g as an ONNX file in double: input x (rows, state_dim), output g. With "
           "`libsvm_scale`, g is multiplied by it, as in scikit-learn and LIBSVM.")
      .def_property_readonly("state_dim", &OneClassSvm::state_dim)
      .def_property_readonly("gamma", &OneClassSvm::gamma)
      .def_property_readonly("rho", &OneClassSvm::rho)
      .def_property_readonly("libsvm_scale", &OneClassSvm::libsvm_scale)
      .def_property_readonly("lipschitz_bound", &OneClassSvm::lipschitz_bound)
      .def_property_readonly("alpha",
                             [](const py::object& self) {
                               return View(self.cast<const OneClassSvm&>().alpha(), self);
                             })
      .def_property_readonly("support_vectors",
                             [](const py::object& self) {
                               return View(self.cast<const OneClassSvm&>().support_vectors(), self);
                             })
      .def("__repr__", [](const OneClassSvm& svm) {
        return "<dfr.SupportEstimate: " + std::to_string(svm.num_support_vectors()) +
               " support vectors of " + std::to_string(svm.state_dim()) + " entries>";
      });

  module.def("find_non_finite", &FindNonFinite, py::arg("x"),
             "Row and column of the first entry that is not finite, or None.");
  module.def("variance", &Variance, py::arg("x"),
             "Variance of all entries, without a temporary array.");
}

}  // namespace dfr::python
