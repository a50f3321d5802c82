#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <Eigen/Core>
#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <span>
#include <string>
#include <thread>
#include <vector>

#include "dfr/core/contract.h"
#include "dfr/core/features/features.h"
#include "dfr/core/matrix.h"
#include "dfr/kernel/one_class_svm.h"
#include "interpreter_lock.h"

namespace dfr::python {

/// Returns Python's text for an object, in one line of at most about 60 characters.
[[nodiscard]] std::string Shortened(const pybind11::handle& value);

/// Returns the name and the size of each block; the shape of a picture is (height, width,
/// channels).
[[nodiscard]] pybind11::list Blocks(const core::StateLayout& layout);

/// Contiguous rows of doubles. As an argument, a C-contiguous float64 array is used directly. Other
/// arguments are converted if NumPy can make numbers of them, including torch tensors. Anything
/// without real numbers raises TypeError in one line (ToArray()).
struct Array : pybind11::array_t<double, pybind11::array::c_style | pybind11::array::forcecast> {
  using array_t::array_t;
};
/// @throws pybind11::type_error with the content of `values` if it is not numeric.
[[nodiscard]] Array ToArray(const pybind11::handle& values);

/// Demonstrations as an argument: one array per demonstration, from any iterable.
struct Arrays {
  std::vector<Array> each;
};
/// @throws pybind11::type_error naming the demonstration.
[[nodiscard]] Arrays ToArrays(const pybind11::handle& values);

/// Converts a function's option to T. pybind11's own error would repeat all arguments, including
/// arrays.
/// @param kind  the required type, for example "a number"
/// @throws pybind11::type_error in one line.
template <typename T>
[[nodiscard]] T Option(const pybind11::object& value, const char* name, const char* kind) {
  try {
    return value.cast<T>();
  } catch (const pybind11::cast_error&) {
    throw pybind11::type_error(std::string(name) + " must be " + kind + ", not " +
                               Shortened(value));
  }
}
[[nodiscard]] inline double RealOption(const pybind11::object& value, const char* name) {
  return Option<double>(value, name, "a number");
}
/// Converts one number, which counts as a sequence of one, or several numbers. A single 0 gives an
/// empty sequence.
[[nodiscard]] inline std::vector<double> RealsOption(const pybind11::object& value,
                                                     const char* name) {
  // An array without dimensions has the type of a sequence.
  const bool scalar = pybind11::hasattr(value, "ndim") && value.attr("ndim").cast<int>() == 0;
  if (scalar || !pybind11::isinstance<pybind11::sequence>(value)) {
    const double number = RealOption(value, name);
    return number == 0.0 ? std::vector<double>{} : std::vector<double>{number};
  }
  return Option<std::vector<double>>(value, name, "a number, or one for each entry of an action");
}
[[nodiscard]] inline int WholeOption(const pybind11::object& value, const char* name) {
  return Option<int>(value, name, "a whole number");
}
[[nodiscard]] inline std::string TextOption(const pybind11::object& value, const char* name) {
  return Option<std::string>(value, name, "text");
}
[[nodiscard]] inline bool FlagOption(const pybind11::object& value, const char* name) {
  return Option<bool>(value, name, "True or False");
}

using MatrixView = Eigen::Map<const core::Matrix>;

/// Returns a view of the array's memory. A vector is one row.
/// @throws std::invalid_argument naming `what` unless it has one or two dimensions.
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

/// Returns a new vector, with a copy of `values` if they are given. pybind11 2.10's constructor
/// from a count reads the size of an entry where NumPy 1 keeps it in a dtype. With NumPy 2, all
/// entries would then share the first entry's memory.
inline pybind11::array_t<double> NewVector(pybind11::ssize_t count,
                                           const double* values = nullptr) {
  return pybind11::array_t<double>(pybind11::array::ShapeContainer{count}, values);
}

/// @throws std::invalid_argument if the time step is negative.
inline void CheckStep(std::int64_t t) {
  DFR_THROW_UNLESS(t >= 0, "t must not be negative, as "
                               << t
                               << " is: time steps begin at 0, and steps after the last "
                                  "demonstrated step use the last estimate");
}
/// Converts time steps to NumPy's 64-bit integers: no wrap-around, and fractions are rejected.
/// @throws std::invalid_argument unless they are integers and not negative.
inline pybind11::array_t<std::int64_t> Steps(const pybind11::object& t) {
  const auto array = pybind11::array::ensure(t);
  // NumPy makes an empty list an array of floating-point numbers.
  DFR_THROW_UNLESS(array && (array.dtype().kind() == 'i' || array.dtype().kind() == 'u' ||
                             (array.size() == 0 && array.dtype().kind() == 'f')),
                   "t must hold integers that fit into 64 bits");
  auto steps = pybind11::array_t<std::int64_t, pybind11::array::c_style |
                                                   pybind11::array::forcecast>::ensure(array);
  for (pybind11::ssize_t i = 0; i < steps.size(); ++i) {
    // An unsigned number beyond 63 bits became negative.
    if (array.dtype().kind() == 'u' && steps.data()[i] < 0) {
      steps.mutable_data()[i] = std::numeric_limits<std::int64_t>::max();
    }
    CheckStep(steps.data()[i]);
  }
  return steps;
}
/// Returns the nearest 64-bit integer of one time step.
/// @throws pybind11::type_error unless `t` is a whole number, of Python or NumPy.
[[nodiscard]] std::int64_t WholeStep(const pybind11::object& t);
/// Returns the nearest int: later time steps use the last estimate.
inline int NearestInt(std::int64_t value) noexcept {
  return static_cast<int>(std::clamp<std::int64_t>(value, std::numeric_limits<int>::min(),
                                                   std::numeric_limits<int>::max()));
}

/// Prevents Python from creating an object without its C++ part: Class.__new__(Class) raises
/// TypeError instead of returning uninitialised members. Such a class is pickled by __reduce__,
/// because copyreg calls __new__.
template <typename Class, typename... Options>
void RefuseBareObjects(pybind11::class_<Class, Options...>& type) {
  // With a separate tp_new, Python rejects the base's object_new for this class.
  reinterpret_cast<PyTypeObject*>(type.ptr())->tp_new = [](PyTypeObject* self, PyObject* /*args*/,
                                                           PyObject* /*kwargs*/) -> PyObject* {
    return pybind11::detail::make_new_instance(self);
  };
}

/// Pickles the result of `get(self)`, from which `from` restores an object.
template <typename Class, typename Get, typename From>
void PickleBy(pybind11::class_<Class>& type, Get get, From from) {
  RefuseBareObjects(type);
  type.def_static("_from_state", from, pybind11::arg("state"));
  type.def("__reduce__", [get](const pybind11::object& self) {
    return pybind11::make_tuple(pybind11::module_::import("dfr._pickling").attr("restore"),
                                pybind11::make_tuple(self.get_type(), get(self)));
  });
}

/// Returns the memory of the C++ object behind `owner` as a read-only array that keeps the owner
/// alive.
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

/// Progress check of fits that run without the interpreter's lock. Returns false once Ctrl-C was
/// pressed; Throw() then raises KeyboardInterrupt. Any thread may call GoOn(); the thread that
/// created the object handles the signals.
class Interruptible {
 public:
  bool GoOn() {
    if (interrupted_ || std::this_thread::get_id() != owner_) return !interrupted_;
    const auto now = std::chrono::steady_clock::now();
    if (now < next_) return true;
    // The interval is short enough for users and long enough for other Python threads.
    next_ = now + std::chrono::milliseconds(100);
    interrupted_ = WithLock([] { return PyErr_CheckSignals() != 0; });
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

/// @throws FileNotFoundError if nothing is at `path`.
void RequireFile(const std::filesystem::path& path);

/// Each function adds its classes or functions to the module.
void AddSupportEstimate(pybind11::module_& module);
void AddTimeVaryingSupport(pybind11::module_& module);
void AddGuard(pybind11::module_& module);
void AddDemonstrations(pybind11::module_& module);
/// The engine of dfr/_experiment.py, which documents these functions.
void AddExperiment(pybind11::module_& module);

/// Pickled state of a SupportEstimate. A TimeVaryingSupport is pickled as a list of such states.
pybind11::tuple GetState(const kernel::OneClassSvm& svm);
kernel::OneClassSvm FromState(const pybind11::tuple& state);

}  // namespace dfr::python

namespace pybind11::detail {

// For functions with several overloads, the first round accepts only float64 arrays.
template <>
struct type_caster<dfr::python::Array> {
  PYBIND11_TYPE_CASTER(dfr::python::Array, const_name("ArrayLike"));
  bool load(handle source, bool convert) {
    if (!convert && !dfr::python::Array::check_(source)) return false;
    value = dfr::python::ToArray(source);
    return true;
  }
};
template <>
struct type_caster<dfr::python::Arrays> {
  PYBIND11_TYPE_CASTER(dfr::python::Arrays, const_name("Sequence[ArrayLike]"));
  bool load(handle source, bool /*convert*/) {
    value = dfr::python::ToArrays(source);
    return true;
  }
};

}  // namespace pybind11::detail
