#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <Eigen/Core>
#include <atomic>
#include <chrono>
#include <span>
#include <thread>

#include "dfr/core/contract.h"
#include "dfr/core/matrix.h"
#include "dfr/kernel/one_class_svm.h"

namespace dfr::python {

/// Rows of doubles one after another. A C-contiguous array of float64 is taken as it is; anything
/// else that NumPy makes one of is converted.
using Array = pybind11::array_t<double, pybind11::array::c_style | pybind11::array::forcecast>;
using MatrixView = Eigen::Map<const core::Matrix>;

/// The array's own memory. A vector is one row.
/// @throws std::invalid_argument naming `what` unless it has one dimension or two.
inline MatrixView Rows(const Array& array, const char* what) {
  DFR_THROW_UNLESS(array.ndim() == 1 || array.ndim() == 2,
                   what << " must have 1 or 2 dimensions, not " << array.ndim());
  return array.ndim() == 1 ? MatrixView(array.data(), 1, array.shape(0))
                           : MatrixView(array.data(), array.shape(0), array.shape(1));
}

inline std::span<const double> Entries(const Array& array) {
  return {array.data(), static_cast<std::size_t>(array.size())};
}
inline std::span<double> Entries(pybind11::array_t<double>& array) {
  return {array.mutable_data(), static_cast<std::size_t>(array.size())};
}

/// Memory of the C++ object behind `owner` as an array that cannot be written to and keeps the
/// owner alive.
inline pybind11::array_t<double> View(const core::Matrix& matrix, pybind11::handle owner) {
  pybind11::array_t<double> array({matrix.rows(), matrix.cols()}, matrix.data(), owner);
  array.attr("setflags")(pybind11::arg("write") = false);
  return array;
}
inline pybind11::array_t<double> View(const Eigen::VectorXd& vector, pybind11::handle owner) {
  pybind11::array_t<double> array(vector.size(), vector.data(), owner);
  array.attr("setflags")(pybind11::arg("write") = false);
  return array;
}

/// What fits ask from time to time, without the interpreter's lock: whether to go on. False once
/// Ctrl-C was pressed; Throw() then raises KeyboardInterrupt. Any thread may ask; the one that made
/// it sees to the signals.
class Interruptible {
 public:
  bool GoOn() {
    if (interrupted_ || std::this_thread::get_id() != owner_) return !interrupted_;
    const auto now = std::chrono::steady_clock::now();
    if (now < next_) return true;
    // Often enough for a person, seldom enough for other Python threads.
    next_ = now + std::chrono::milliseconds(100);
    const pybind11::gil_scoped_acquire lock;
    interrupted_ = PyErr_CheckSignals() != 0;
    return !interrupted_;
  }
  void Throw() const {
    if (interrupted_) throw pybind11::error_already_set();
  }

 private:
  std::thread::id owner_ = std::this_thread::get_id();
  std::chrono::steady_clock::time_point next_ =
      std::chrono::steady_clock::now() + std::chrono::milliseconds(100);
  std::atomic<bool> interrupted_ = false;
};

/// Each adds its classes to the module.
void AddSupportEstimate(pybind11::module_& module);
void AddTimeVaryingSupport(pybind11::module_& module);
void AddGuard(pybind11::module_& module);

/// How SupportEstimate is pickled, which TimeVaryingSupport is a list of.
pybind11::tuple GetState(const kernel::OneClassSvm& svm);
kernel::OneClassSvm FromState(const pybind11::tuple& state);

}  // namespace dfr::python
