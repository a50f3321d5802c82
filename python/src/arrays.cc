#include "arrays.h"

#include <cerrno>

namespace py = pybind11;

namespace dfr::python {
namespace {

// Describes a non-numeric type, given its numpy.dtype.kind.
const char* KindOf(char kind) {
  switch (kind) {
    case 'c':
      return "complex numbers";
    case 'S':
    case 'U':
      return "text";
    case 'M':
    case 'm':
      return "times";
    case 'V':
      return "records with named fields";
    default:
      return "other objects";
  }
}

// Returns a tensor's values in main memory, without the autograd graph; other values unchanged.
py::object Detached(const py::handle& values) {
  if (!py::hasattr(values, "detach")) return py::reinterpret_borrow<py::object>(values);
  const py::object detached = values.attr("detach")();
  return py::hasattr(detached, "cpu") ? py::object(detached.attr("cpu")()) : detached;
}

}  // namespace

py::list Blocks(const core::StateLayout& layout) {
  py::list blocks;
  for (const auto& block : layout.blocks) {
    const auto& [height, width, channels] = block.picture;
    blocks.append(py::make_tuple(block.name, height == 0
                                                 ? py::object(py::int_(block.size))
                                                 : py::make_tuple(height, width, channels)));
  }
  return blocks;
}

std::string Shortened(const py::handle& value) {
  constexpr std::size_t kMost = 60;
  std::string text;
  try {
    text = py::repr(value).cast<std::string>();
  } catch (const py::error_already_set&) {
    text = "an object";  // an integer of thousands of digits, for example
  }
  for (char& c : text) c = c == '\n' ? ' ' : c;
  if (text.size() > kMost) {
    std::size_t end = kMost;
    while (end > 0 && (text[end] & 0xC0) == 0x80) --end;  // within a character of UTF-8
    text = text.substr(0, end) + "...";
  }
  return text + " of type " + std::string(py::str(py::type::of(value).attr("__name__")));
}

Array ToArray(const py::handle& values) {
  // A masked array has its own class; plain access would ignore its mask.
  const bool plain = Py_TYPE(values.ptr()) == py::detail::npy_api::get().PyArray_Type_;
  if (plain && Array::check_(values)) return py::reinterpret_borrow<Array>(values);
  const py::module_ numpy = py::module_::import("numpy");
  const std::string remedy = "an array of real numbers is needed, one row per state or action";
  try {
    if (numpy.attr("ma").attr("is_masked")(values).cast<bool>()) {
      throw py::type_error("the array has masked entries: fill or drop them");
    }
    if (py::isinstance<py::dict>(values)) {
      throw py::type_error(remedy +
                           ", not a dict: concatenate its parts in the order of the layout");
    }
    const auto array = py::array::ensure(numpy.attr("asarray")(Detached(values)));
    if (!array) throw py::error_already_set();
    const char kind = array.dtype().kind();
    if (kind != 'b' && kind != 'i' && kind != 'u' && kind != 'f' && kind != 'O') {
      throw py::type_error(remedy + ", not " + KindOf(kind) + ": " + Shortened(values));
    }
    return py::reinterpret_steal<Array>(
        array.attr("astype")("float64", py::arg("order") = "C").release());
  } catch (const py::error_already_set& e) {
    if (e.matches(PyExc_OverflowError)) {
      throw py::value_error("a number is too large for double precision: " + Shortened(values));
    }
    if (!e.matches(PyExc_ValueError) && !e.matches(PyExc_TypeError)) throw;
    throw py::type_error(remedy +
                         ", not rows of different lengths or other objects: " + Shortened(values));
  }
}

std::int64_t WholeStep(const py::object& t) {
  const auto index = py::reinterpret_steal<py::object>(PyNumber_Index(t.ptr()));
  if (!index) {
    const py::error_already_set error;
    if (!error.matches(PyExc_TypeError)) throw error;
    throw py::type_error("t must be a whole number, as int(t) is, not " + Shortened(t));
  }
  int overflow = 0;
  const std::int64_t value = PyLong_AsLongLongAndOverflow(index.ptr(), &overflow);
  return overflow > 0 ? std::numeric_limits<std::int64_t>::max() : value;
}

void RequireFile(const std::filesystem::path& path) {
  std::error_code error;
  if (std::filesystem::exists(path, error) || error) return;
  errno = ENOENT;
  PyErr_SetFromErrnoWithFilename(PyExc_OSError, path.c_str());
  throw py::error_already_set();
}

Arrays ToArrays(const py::handle& values) {
  if (py::isinstance<py::str>(values) || py::isinstance<py::bytes>(values) ||
      py::isinstance<py::dict>(values) || !py::hasattr(values, "__iter__")) {
    throw py::type_error("a list of arrays is needed, one per demonstration, not " +
                         Shortened(values));
  }
  Arrays arrays;
  for (const py::handle& one : values) {
    try {
      arrays.each.push_back(ToArray(one));
    } catch (const py::type_error& e) {
      throw py::type_error("demonstration " + std::to_string(arrays.each.size()) + ": " + e.what());
    }
  }
  return arrays;
}

}  // namespace dfr::python
