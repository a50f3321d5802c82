#include "dfr/hardware/intrinsics_file.h"

#include <algorithm>
#include <cerrno>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <fstream>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "dfr/core/files/read_file.h"
#include "dfr/core/text/numbers.h"

namespace dfr::hardware {
namespace {

constexpr std::string_view kBlank = " \t\r\n";

std::string_view Trimmed(std::string_view text) {
  text.remove_prefix(std::min(text.find_first_not_of(kBlank), text.size()));
  return text.substr(0, text.find_last_not_of(kBlank) + 1);
}

// The subset of YAML in which OpenCV and ROS write calibrations: keys with inline or indented
// values, and lists in brackets.
class Yaml {
 public:
  static std::optional<std::string> Find(std::string_view text, std::string_view key) {
    // Indentation of the first key of this level.
    std::size_t level = std::string_view::npos;
    std::optional<std::string> found;
    bool within = false;  // inside the key's value
    while (!text.empty()) {
      const std::string_view line = text.substr(0, text.find('\n'));
      text.remove_prefix(std::min(text.size(), line.size() + 1));
      const std::size_t indent = line.find_first_not_of(" \t");
      if (Trimmed(line).empty() || line[indent] == '#' || line[indent] == '%') continue;
      if (indent == 0 && (line.starts_with("---") || line.starts_with("..."))) continue;
      // A list continues while its bracket is open. Its entries may be indented like its key.
      const bool open =
          within && found->find('[') != std::string::npos && found->find(']') == std::string::npos;
      if (within && (open || indent > level || line[indent] == '-')) {
        found->append("\n").append(line);
        continue;
      }
      if (found) return found;
      level = std::min(level, indent);
      const std::string_view entry = line.substr(indent);
      if (indent != level || !entry.starts_with(key)) continue;
      const std::string_view rest = entry.substr(key.size());
      const std::size_t colon = rest.find_first_not_of(" \t");
      if (colon == std::string_view::npos || rest[colon] != ':') continue;
      found = WithoutTag(rest.substr(colon + 1));
      within = true;
    }
    return found;
  }

 private:
  // Removes OpenCV's type tag, !!opencv-matrix.
  static std::string WithoutTag(std::string_view value) {
    value = Trimmed(value);
    if (value.starts_with("!!")) value.remove_prefix(std::min(value.find(' '), value.size()));
    return std::string(Trimmed(value));
  }
};

// The subset of XML that OpenCV writes: elements without namespaces, escapes or comments.
class Xml {
 public:
  static std::optional<std::string> Find(std::string_view text, std::string_view key) {
    const std::string open = std::string(1, '<').append(key);
    const std::string close = std::string("</").append(key).append(">");
    for (std::size_t at = text.find(open); at != std::string_view::npos;
         at = text.find(open, at + 1)) {
      const std::string_view behind = text.substr(at + open.size());
      if (behind.empty() ||
          (behind[0] != '>' && kBlank.find(behind[0]) == std::string_view::npos)) {
        continue;
      }
      const std::size_t begin = behind.find('>');
      const std::size_t end = behind.find(close);
      if (begin == std::string_view::npos || end == std::string_view::npos || end < begin) break;
      return std::string(Trimmed(behind.substr(begin + 1, end - begin - 1)));
    }
    return std::nullopt;
  }
};

class Reader {
 public:
  explicit Reader(const std::filesystem::path& path) : file_(path.string()) {
    constexpr std::size_t kMost = 1 << 20;
    core::CheckPlainFile(path);
    std::ifstream in(path, std::ios::binary);
    text_.resize(kMost + 1);
    if (!in) Fail(std::string("cannot be read: ") + std::strerror(errno));
    in.read(text_.data(), static_cast<std::streamsize>(text_.size()));
    text_.resize(static_cast<std::size_t>(in.gcount()));
    if (in.bad() || text_.empty()) Fail("cannot be read, or is empty");
    if (text_.size() > kMost) Fail("is not a calibration: it is longer than a mebibyte");
    if (text_.find('\0') != std::string::npos) Fail(kNeither);
    xml_ = Trimmed(text_).starts_with("<");
    if (xml_ && text_.find("</opencv_storage>") == std::string::npos) Fail(kNeither);
  }

  [[noreturn]] void Fail(const std::string& what) const {
    throw std::runtime_error(file_ + ": " + what);
  }

  int Integer(const char* key) const {
    const std::optional<int> value = core::ParseInteger<int>(Node(key));
    if (!value) Fail(std::string(key) + " is not a whole number");
    return *value;
  }

  std::vector<double> Matrix(const char* key, int& rows, int& cols) const {
    const std::string node = Node(key);
    const std::string of_key = std::string(key) + " ";
    const auto size = [&](const char* name) {
      const std::optional<std::string> text = Find(node, name);
      const std::optional<int> value = text ? core::ParseInteger<int>(*text) : std::nullopt;
      if (!value || *value < 0) Fail(of_key + "is not a matrix (rows, cols, data)");
      return *value;
    };
    rows = size("rows");
    cols = size("cols");
    const std::optional<std::string> data = Find(node, "data");
    if (!data) Fail(of_key + "is not a matrix (rows, cols, data)");
    std::vector<double> values = Numbers(*data, of_key);
    if (static_cast<std::int64_t>(rows) * cols != static_cast<std::int64_t>(values.size())) {
      Fail(of_key + "has " + std::to_string(values.size()) + " entries, not " +
           std::to_string(rows) + " x " + std::to_string(cols));
    }
    return values;
  }

 private:
  static constexpr char kNeither[] =
      "is neither YAML nor XML in the form of OpenCV's and ROS' calibrations";

  [[nodiscard]] std::optional<std::string> Find(std::string_view text, const char* key) const {
    return xml_ ? Xml::Find(text, key) : Yaml::Find(text, key);
  }

  std::string Node(const char* key) const {
    std::optional<std::string> node = Find(text_, key);
    if (!node) {
      Fail(std::string(key) +
           " is missing; a calibration has image_width, image_height, camera_matrix and "
           "distortion_coefficients");
    }
    return *std::move(node);
  }

  // Parses "[1., 2.]", lines that begin with "- ", or, in XML, plain numbers.
  std::vector<double> Numbers(std::string_view text, const std::string& of_key) const {
    const bool brackets = text.starts_with('[');
    if (brackets) {
      const std::size_t end = text.find(']');
      if (end == std::string_view::npos) Fail(of_key + "has a list that does not end with ]");
      text = text.substr(1, end - 1);
    }
    std::vector<double> values;
    constexpr std::string_view kSeparators = " \t\r\n,";
    while (true) {
      text.remove_prefix(std::min(text.find_first_not_of(kSeparators), text.size()));
      if (text.empty()) return values;
      const std::string_view word = text.substr(0, text.find_first_of(kSeparators));
      text.remove_prefix(word.size());
      if (!brackets && !xml_ && word == "-") continue;
      const std::optional<double> value = core::ParseNumber(word);
      if (!value &&
          (core::LooksLikeNumber(word) || word.starts_with('.') || word.starts_with("-."))) {
        Fail(of_key + "has an entry that is not a finite number");
      }
      if (!value) Fail(of_key + "has an entry that is not a number");
      values.push_back(*value);
    }
  }

  std::string file_;
  std::string text_;
  bool xml_ = false;
};

}  // namespace

vision::CameraModel ReadIntrinsics(const std::filesystem::path& path) {
  const Reader reader(path);
  vision::CameraModel camera;
  camera.width = reader.Integer("image_width");
  camera.height = reader.Integer("image_height");
  int rows = 0;
  int cols = 0;
  const std::vector<double> k = reader.Matrix("camera_matrix", rows, cols);
  if (rows != 3 || cols != 3) reader.Fail("camera_matrix is not 3 x 3");
  if (k[1] != 0.0 || k[3] != 0.0 || k[6] != 0.0 || k[7] != 0.0 || k[8] != 1.0) {
    reader.Fail("camera_matrix is not (fx 0 cx; 0 fy cy; 0 0 1): skew is not supported");
  }
  camera.fx = k[0];
  camera.fy = k[4];
  camera.cx = k[2];
  camera.cy = k[5];
  const std::vector<double> d = reader.Matrix("distortion_coefficients", rows, cols);
  if (d.size() != 4 && d.size() != 5 && d.size() != 8 && d.size() != 12 && d.size() != 14) {
    reader.Fail("distortion_coefficients has " + std::to_string(d.size()) +
                " entries; supported: 4, 5, 8, 12 and 14");
  }
  for (std::size_t i = 0; i < d.size(); ++i) {
    if (i < camera.distortion.size()) {
      camera.distortion[i] = d[i];
    } else if (d[i] != 0.0) {
      reader.Fail("distortion_coefficients: entry " + std::to_string(i + 1) +
                  " belongs to a model that is not supported; calibrate with k1, k2, p1, p2, k3 "
                  "alone (no CALIB_RATIONAL_MODEL)");
    }
  }
  try {
    camera.Check();
  } catch (const std::invalid_argument& e) {
    reader.Fail(std::string("camera_matrix is not valid: ") + e.what());
  }
  return camera;
}

}  // namespace dfr::hardware
