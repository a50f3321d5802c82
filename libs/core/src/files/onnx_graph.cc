#include "dfr/core/files/onnx_graph.h"

#include <bit>
#include <cstring>
#include <stdexcept>

#include "dfr/core/build_info.h"
#include "dfr/core/contract.h"
#include "dfr/core/files/atomic_file.h"

namespace dfr::core {
namespace {

static_assert(std::endian::native == std::endian::little, "raw_data of ONNX is little-endian");

constexpr int kIrVersion = 8;
constexpr int kOperatorSet = 17;

// Subset of Protocol Buffers' wire format that ONNX needs: integer and byte fields.
void AppendVarint(std::string& out, std::uint64_t value) {
  for (; value >= 0x80; value >>= 7) out.push_back(static_cast<char>(value | 0x80));
  out.push_back(static_cast<char>(value));
}
void AppendInteger(std::string& out, int field, std::int64_t value) {
  AppendVarint(out, static_cast<std::uint64_t>(field) << 3);
  AppendVarint(out, static_cast<std::uint64_t>(value));
}
void AppendBytes(std::string& out, int field, std::string_view bytes) {
  AppendVarint(out, static_cast<std::uint64_t>(field) << 3 | 2);
  AppendVarint(out, bytes.size());
  out.append(bytes);
}

// Field numbers of onnx.proto, by message.
namespace model {
constexpr int kIr = 1, kProducer = 2, kProducerVersion = 3, kGraph = 7, kOperatorSets = 8;
}
namespace operator_set {
constexpr int kVersion = 2;
}
namespace graph {
constexpr int kNode = 1, kName = 2, kInitializer = 5, kInput = 11, kOutput = 12;
}
namespace node {
constexpr int kInput = 1, kOutput = 2, kOperator = 4, kAttribute = 5;
}
namespace attribute {
constexpr int kName = 1, kInteger = 3, kType = 20;
constexpr int kTypeInteger = 2;
}  // namespace attribute
namespace tensor {
constexpr int kDimension = 1, kType = 2, kName = 8, kRaw = 9;
}
namespace value_info {
constexpr int kName = 1, kType = 2;
constexpr int kTensorType = 1;
constexpr int kElementType = 1, kShape = 2;
constexpr int kDimension = 1;
constexpr int kDimensionValue = 1, kDimensionName = 2;
}  // namespace value_info

std::string ValueInfo(const std::string& name, OnnxGraph::Type type,
                      std::span<const std::int64_t> shape) {
  std::string dimensions;
  for (const std::int64_t size : shape) {
    std::string dimension;
    if (size < 0) {
      AppendBytes(dimension, value_info::kDimensionName, "rows");
    } else {
      AppendInteger(dimension, value_info::kDimensionValue, size);
    }
    AppendBytes(dimensions, value_info::kDimension, dimension);
  }
  std::string tensor_type;
  AppendInteger(tensor_type, value_info::kElementType, static_cast<int>(type));
  AppendBytes(tensor_type, value_info::kShape, dimensions);
  std::string type_proto;
  AppendBytes(type_proto, value_info::kTensorType, tensor_type);
  std::string info;
  AppendBytes(info, value_info::kName, name);
  AppendBytes(info, value_info::kType, type_proto);
  return info;
}

template <typename T>
std::string Tensor(const std::string& name, OnnxGraph::Type type, std::span<const T> values,
                   std::span<const std::int64_t> shape) {
  std::int64_t count = 1;
  for (const std::int64_t size : shape) count *= size;
  DFR_THROW_UNLESS(count == static_cast<std::int64_t>(values.size()),
                   values.size() << " values do not fill a constant of " << count);
  std::string tensor;
  for (const std::int64_t size : shape) AppendInteger(tensor, tensor::kDimension, size);
  AppendInteger(tensor, tensor::kType, static_cast<int>(type));
  AppendBytes(tensor, tensor::kName, name);
  std::string raw(values.size_bytes(), '\0');
  if (!values.empty()) std::memcpy(raw.data(), values.data(), values.size_bytes());
  AppendBytes(tensor, tensor::kRaw, raw);
  return tensor;
}

std::string NodeText(std::string_view op, std::span<const std::string> inputs,
                     const std::string& output, std::span<const OnnxGraph::Attribute> attributes) {
  std::string text;
  for (const std::string& input : inputs) AppendBytes(text, node::kInput, input);
  AppendBytes(text, node::kOutput, output);
  AppendBytes(text, node::kOperator, op);
  for (const OnnxGraph::Attribute& a : attributes) {
    std::string attribute_text;
    AppendBytes(attribute_text, attribute::kName, a.name);
    AppendInteger(attribute_text, attribute::kInteger, a.value);
    AppendInteger(attribute_text, attribute::kType, attribute::kTypeInteger);
    AppendBytes(text, node::kAttribute, attribute_text);
  }
  return text;
}

}  // namespace

OnnxGraph::OnnxGraph(std::string_view name) : name_(name) {
  DFR_THROW_UNLESS(!name_.empty(), "an ONNX graph needs a name");
}

std::string OnnxGraph::NewName(std::string_view what) {
  return std::string(what) + "_" + std::to_string(names_++);
}

std::string OnnxGraph::Input(const std::string& name, Type type,
                             std::span<const std::int64_t> shape) {
  AppendBytes(inputs_, graph::kInput, ValueInfo(name, type, shape));
  return name;
}

void OnnxGraph::Output(const std::string& value, const std::string& name, Type type,
                       std::span<const std::int64_t> shape) {
  AppendBytes(nodes_, graph::kNode, NodeText("Identity", std::span(&value, 1), name, {}));
  AppendBytes(outputs_, graph::kOutput, ValueInfo(name, type, shape));
}

std::string OnnxGraph::Constant(std::span<const double> values,
                                std::span<const std::int64_t> shape) {
  std::string name = NewName("constant");
  AppendBytes(constants_, graph::kInitializer, Tensor(name, Type::kDouble, values, shape));
  return name;
}

std::string OnnxGraph::Constant(std::span<const std::int64_t> values,
                                std::span<const std::int64_t> shape) {
  std::string name = NewName("constant");
  AppendBytes(constants_, graph::kInitializer, Tensor(name, Type::kInt64, values, shape));
  return name;
}

std::string OnnxGraph::Vector(std::span<const double> values) {
  const auto size = static_cast<std::int64_t>(values.size());
  return Constant(values, std::span(&size, 1));
}

std::string OnnxGraph::Integers(std::initializer_list<std::int64_t> values) {
  const auto size = static_cast<std::int64_t>(values.size());
  return Constant(std::span<const std::int64_t>(values.begin(), values.size()),
                  std::span(&size, 1));
}

std::string OnnxGraph::Matrix2d(const Matrix& values) {
  const std::int64_t shape[] = {values.rows(), values.cols()};
  return Constant(std::span(values.data(), static_cast<std::size_t>(values.size())), shape);
}

std::string OnnxGraph::Node(std::string_view op, std::initializer_list<std::string> inputs,
                            std::initializer_list<Attribute> attributes) {
  std::string name = NewName(op);
  AppendBytes(nodes_, graph::kNode,
              NodeText(op, std::span(inputs.begin(), inputs.size()), name,
                       std::span(attributes.begin(), attributes.size())));
  return name;
}

std::string OnnxGraph::Serialize() const {
  std::string body = nodes_;
  AppendBytes(body, graph::kName, name_);
  body += constants_ + inputs_ + outputs_;
  std::string operators;
  AppendInteger(operators, operator_set::kVersion, kOperatorSet);
  std::string file;
  AppendInteger(file, model::kIr, kIrVersion);
  AppendBytes(file, model::kProducer, "dfr");
  AppendBytes(file, model::kProducerVersion, BuildVersion());
  AppendBytes(file, model::kGraph, body);
  AppendBytes(file, model::kOperatorSets, operators);
  return file;
}

void OnnxGraph::Save(const std::filesystem::path& path) const {
  const std::string content = Serialize();
  // Readers of Protocol Buffers reject larger messages.
  constexpr std::size_t kMost = 0x7fffffff;
  if (content.size() > kMost) {
    throw std::runtime_error(path.string() + ": needs " + std::to_string(content.size()) +
                             " bytes; an ONNX file can have at most 2 GiB");
  }
  ReplaceFile(path, content);
}

}  // namespace dfr::core
