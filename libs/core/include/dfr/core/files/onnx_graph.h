#pragma once

#include <cstdint>
#include <filesystem>
#include <initializer_list>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "dfr/core/matrix.h"

namespace dfr::core {

/// Builder of an ONNX file (operator set 17, IR version 8) of double and int64 values. Values have
/// names: calls that create a value return its name, and later calls take it. Several libraries
/// append their parts to one file: see kernel/onnx_export.h and imitation/onnx_export.h.
class OnnxGraph {
 public:
  enum class Type { kDouble = 11, kInt64 = 7 };

  /// `name` is stored in the file. @throws std::invalid_argument if it is empty.
  explicit OnnxGraph(std::string_view name);

  /// Declares an input. A negative entry of `shape` leaves that size open, for example the number
  /// of rows.
  std::string Input(const std::string& name, Type type, std::span<const std::int64_t> shape);
  std::string Input(const std::string& name, Type type, std::initializer_list<std::int64_t> shape) {
    return Input(name, type, std::span(shape.begin(), shape.size()));
  }
  /// Declares `value` as an output called `name`.
  void Output(const std::string& value, const std::string& name, Type type,
              std::span<const std::int64_t> shape);
  void Output(const std::string& value, const std::string& name, Type type,
              std::initializer_list<std::int64_t> shape) {
    Output(value, name, type, std::span(shape.begin(), shape.size()));
  }

  /// Adds a constant of the given shape (empty: a scalar), row-major.
  /// @throws std::invalid_argument if the number of values does not match the shape.
  std::string Constant(std::span<const double> values, std::span<const std::int64_t> shape);
  std::string Constant(std::span<const std::int64_t> values, std::span<const std::int64_t> shape);
  std::string Constant(double value) { return Constant(std::span(&value, 1), {}); }
  std::string Vector(std::span<const double> values);
  std::string Integers(std::initializer_list<std::int64_t> values);
  std::string Matrix2d(const Matrix& values);

  /// Integer attribute of an operator.
  struct Attribute {
    std::string_view name;
    std::int64_t value;
  };
  /// Adds an operator with one result and returns the result's name. Optional inputs may be "".
  std::string Node(std::string_view op, std::initializer_list<std::string> inputs,
                   std::initializer_list<Attribute> attributes = {});

  /// Returns the content of the file.
  [[nodiscard]] std::string Serialize() const;
  /// Writes the file as an AtomicFile. @throws std::runtime_error naming the file and the system's
  /// message.
  void Save(const std::filesystem::path& path) const;

 private:
  std::string NewName(std::string_view what);

  std::string name_;
  // Serialised parts, in the order of appending.
  std::string nodes_;
  std::string constants_;
  std::string inputs_;
  std::string outputs_;
  int names_ = 0;
};

}  // namespace dfr::core
