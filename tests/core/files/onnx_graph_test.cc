#include "dfr/core/files/onnx_graph.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <stdexcept>
#include <string>
#include <vector>

#include "tests/support/message_of.h"

namespace dfr::core {
namespace {

using testing::HasSubstr;

// tests/onnx checks the values of the files with ONNX Runtime.

TEST(OnnxGraphTest, MatchesBytesEncodedByHand) {
  OnnxGraph graph("g");
  graph.Output(graph.Input("x", OnnxGraph::Type::kDouble, {-1, 300}), "y", OnnxGraph::Type::kDouble,
               {-1, 300});
  // Fields are (number << 3 | wire type), length and value. 300 is the varint ac 02.
  const std::string shape =
      std::string("\x12\x0d") + "\x0a\x06\x12\x04rows" + "\x0a\x03\x08\xac\x02";
  const std::string type = "\x12\x13\x0a\x11\x08\x0b" + shape;  // tensor of double
  const std::string node = std::string("\x0a\x10") + "\x0a\x01x" + "\x12\x01y" + "\x22\x08Identity";
  const std::string body =
      node + "\x12\x01g" + "\x5a\x18\x0a\x01x" + type + "\x62\x18\x0a\x01y" + type;
  const std::string file = graph.Serialize();
  EXPECT_TRUE(
      file.starts_with("\x08\x08\x12\x03"
                       "dfr\x1a\x05"))
      << "IR version 8, producer";
  EXPECT_THAT(file, HasSubstr("\x3a" + std::string(1, static_cast<char>(body.size())) + body));
  EXPECT_TRUE(file.ends_with("\x42\x02\x10\x11")) << "operator set 17";
}

TEST(OnnxGraphTest, RefusesWrongShapesAndUnwritableFiles) {
  EXPECT_THROW(OnnxGraph(""), std::invalid_argument);
  OnnxGraph graph("g");
  const std::vector<double> values(5, 1.0);
  const std::int64_t shape[] = {2, 3};
  EXPECT_THROW(graph.Constant(values, shape), std::invalid_argument);
  EXPECT_THAT(
      dfr::test::MessageOf<std::runtime_error>([&] { graph.Save("/nonexistent/model.onnx"); }),
      HasSubstr("/nonexistent/model.onnx"));
}

}  // namespace
}  // namespace dfr::core
