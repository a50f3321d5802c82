#pragma once

#include <exception>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <limits>
#include <sstream>
#include <string>
#include <vector>

#include "dfr/core/matrix.h"
#include "dfr/core/random.h"

namespace dfr::test {

using core::Matrix;

inline Matrix Normal(Eigen::Index rows, Eigen::Index cols, core::Random& random) {
  Matrix m(rows, cols);
  for (Eigen::Index i = 0; i < m.size(); ++i) m.data()[i] = random.Normal();
  return m;
}

template <typename T>
std::string List(const T* values, Eigen::Index count) {
  std::ostringstream out;
  out.precision(std::numeric_limits<double>::max_digits10);
  for (Eigen::Index i = 0; i < count; ++i) out << (i == 0 ? "[" : ",") << values[i];
  return out.str() + "]";
}

/// An exported model, inputs, and the library's results, for onnx_peer.cjs.
struct Case {
  std::filesystem::path folder;
  std::string name;
  std::vector<std::string> inputs;

  void Add(const std::string& input, const Matrix& x) {
    inputs.push_back(R"({"name": ")" + input + R"(", "type": "float64", "shape": [)" +
                     std::to_string(x.rows()) + ", " + std::to_string(x.cols()) +
                     R"(], "values": )" + List(x.data(), x.size()) + "}");
  }
  void Add(const std::string& input, const std::vector<int>& t) {
    const auto count = static_cast<Eigen::Index>(t.size());
    inputs.push_back(R"({"name": ")" + input + R"(", "type": "int64", "shape": [)" +
                     std::to_string(count) + R"(], "values": )" + List(t.data(), count) + "}");
  }
  void Write(const std::string& output, const std::string& dims,
             const std::vector<double>& expected) const {
    std::ofstream out(folder / (name + ".json"));
    out << R"({"model": ")" << name << R"(.onnx", "inputs": [)";
    for (std::size_t i = 0; i < inputs.size(); ++i) out << (i == 0 ? "" : ", ") << inputs[i];
    out << R"(], "output": ")" << output << R"(", "dims": )" << dims << R"(, "expected": )"
        << List(expected.data(), static_cast<Eigen::Index>(expected.size())) << "}\n";
  }
  [[nodiscard]] std::filesystem::path model() const { return folder / (name + ".onnx"); }
};

/// The main function of a program that writes cases to a folder. usage: PROGRAM FOLDER
template <typename Write>
int WriteCases(int argc, char** argv, Write write) try {
  const std::filesystem::path folder = argc > 1 ? argv[1] : "";
  std::filesystem::create_directories(folder);
  write(folder);
  return 0;
} catch (const std::exception& e) {
  std::cerr << argv[0] << ": " << e.what() << '\n';
  return 1;
}

}  // namespace dfr::test
