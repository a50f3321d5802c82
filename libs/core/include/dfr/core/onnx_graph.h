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

/// A computation that is written as an ONNX file (operator set 17, IR version 8), in double
/// throughout. Values are named; calls that make one return its name, which later calls take. The
/// libraries append their parts, so that several make one file: see kernel/onnx_export.h and
/// imitation/onnx_export.h.
class OnnxGraph {
 public:
  enum class Type { kDouble = 11, kInt64 = 7 };

  /// `name` stands in the file. @throws std::invalid_argument if it is empty.
  explicit OnnxGraph(std::string_view name);

  /// Declares an input. A negative entry of `shape` is a size left open, the number of rows say.
  std::string Input(const std::string& name, Type type, std::span<const std::int64_t> shape);
  std::string Input(const std::string& name, Type type, std::initializer_list<std::int64_t> shape) {
    return Input(name, type, std::span(shape.begin(), shape.size()));
  }
  /// Makes `value` an output called `name`.
  void Output(const std::string& value, const std::string& name, Type type,
              std::span<const std::int64_t> shape);
  void Output(const std::string& value, const std::string& name, Type type,
              std::initializer_list<std::int64_t> shape) {
    Output(value, name, type, std::span(shape.begin(), shape.size()));
  }

  /// Constants of the given shape (none: a scalar), row-major.
  /// @throws std::invalid_argument if there are not as many values as the shape has.
  std::string Constant(std::span<const double> values, std::span<const std::int64_t> shape);
  std::string Constant(std::span<const std::int64_t> values, std::span<const std::int64_t> shape);
  std::string Constant(double value) { return Constant(std::span(&value, 1), {}); }
  std::string Vector(std::span<const double> values);
  std::string Integers(std::initializer_list<std::int64_t> values);
  std::string Matrix2d(const Matrix& values);

  /// An integer attribute of an operator.
  struct Attribute {
    std::string_view name;
    std::int64_t value;
  };
  /// One operator with one result, whose name is returned. Inputs may be "" where optional.
  std::string Node(std::string_view op, std::initializer_list<std::string> inputs,
                   std::initializer_list<Attribute> attributes = {});

  /// The file's content.
  [[nodiscard]] std::string Serialize() const;
  /// Writes it as an AtomicFile. @throws std::runtime_error naming the file and what the system
  ///   said.
  void Save(const std::filesystem::path& path) const;

 private:
  std::string NewName(std::string_view what);

  std::string name_;
  // Serialised parts, in the order of their addition.
  std::string nodes_;
  std::string constants_;
  std::string inputs_;
  std::string outputs_;
  int names_ = 0;
};

}  // namespace dfr::core
