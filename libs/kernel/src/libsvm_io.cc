#include "dfr/kernel/libsvm_io.h"

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <fstream>
#include <limits>
#include <optional>
#include <span>
#include <sstream>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "dfr/core/files/atomic_file.h"
#include "dfr/core/files/read_budget.h"
#include "dfr/core/text/format.h"
#include "dfr/core/text/numbers.h"

namespace dfr::kernel {
namespace {

// Reads a text file line by line; errors name the position.
class LineReader {
 public:
  LineReader(std::istream& in, std::string name) : in_(in), name_(std::move(name)) {}

  // Reads the next line that is not blank. Returns false at the end.
  bool Next() {
    while (std::getline(in_, line_)) {
      ++number_;
      bytes_ += line_.size() + 1;
      // Byte-order mark, which spreadsheets write for UTF-8.
      if (number_ == 1 && line_.starts_with("\xEF\xBB\xBF")) line_.erase(0, 3);
      if (!line_.empty() && line_.back() == '\r') line_.pop_back();
      if (line_.find_first_not_of(" \t") != std::string::npos) return true;
    }
    if (in_.bad()) Fail("cannot be read");
    return false;
  }

  [[nodiscard]] std::string_view line() const { return line_; }
  [[nodiscard]] std::uint64_t bytes() const { return bytes_; }

  [[noreturn]] void Fail(const std::string& reason) const {
    throw std::runtime_error(name_ + ":" + std::to_string(number_) + ": " + reason);
  }

  // Removes the next space-separated word from `text` and returns it.
  static std::string_view Word(std::string_view& text) {
    const auto first = std::min(text.find_first_not_of(" \t"), text.size());
    text.remove_prefix(first);
    const std::string_view word = text.substr(0, text.find_first_of(" \t"));
    text.remove_prefix(word.size());
    return word;
  }

  [[nodiscard]] double Number(std::string_view word, const char* what) const {
    const std::optional<double> value = core::ParseNumber(word);
    if (!value) {
      Fail(std::string(what) + " must be a finite number, not '" + Quoted(word) + "'");
    }
    return *value;
  }

  [[nodiscard]] int Integer(std::string_view word, const char* what, int low, int high) const {
    const std::optional<int> value = core::ParseInteger<int>(word);
    if (!value || *value < low || *value > high) {
      Fail(std::string(what) + " must be an integer from " + std::to_string(low) + " to " +
           std::to_string(high) + ", not '" + Quoted(word) + "'");
    }
    return *value;
  }

  // Damaged files may contain anything: keeps the quote short and printable.
  static std::string Quoted(std::string_view word) {
    std::string text(word.substr(0, 40));
    for (char& c : text) {
      if (c < ' ' || c > '~') c = '?';
    }
    return text;
  }

 private:
  std::istream& in_;
  std::string name_;
  std::string line_;
  int number_ = 0;
  std::uint64_t bytes_ = 0;
};

std::ifstream Open(const std::filesystem::path& path) {
  std::ifstream in(path);
  if (!in || std::filesystem::is_directory(path)) {
    throw std::runtime_error(path.string() +
                             ": cannot be opened: " + std::strerror(in ? EISDIR : errno));
  }
  return in;
}

// Memory available without swapping; empty if the system does not report it.
std::optional<std::uint64_t> AvailableMemory() {
  std::ifstream in("/proc/meminfo");
  std::string key;
  std::uint64_t kibibytes = 0;
  std::string unit;
  while (in >> key >> kibibytes && std::getline(in, unit)) {
    if (key == "MemAvailable:") return kibibytes << 10;
  }
  return std::nullopt;
}

// Numbers take about as much memory as their text. Reading a file larger than the available memory
// would fail midway and could affect other programs.
void CheckFitsMemory(const std::filesystem::path& path) {
  std::error_code unknown;
  const std::uint64_t size = std::filesystem::file_size(path, unknown);
  const std::optional<std::uint64_t> available = AvailableMemory();
  if (unknown || !available || size <= *available) return;
  throw std::runtime_error(
      core::Format("%s: %.1f GiB of samples are more than the %.1f GiB of available memory: use "
                   "fewer samples, for example every tenth line",
                   path.c_str(), static_cast<double>(size) * 0x1p-30,
                   static_cast<double>(*available) * 0x1p-30));
}

// Entries "1:v 3:v ..." of one line.
struct SparseRow {
  std::vector<std::pair<int, double>> entries;  // 0-based index, value

  [[nodiscard]] int width() const { return entries.empty() ? 0 : entries.back().first + 1; }
};

SparseRow ReadSparse(const LineReader& reader, std::string_view text) {
  SparseRow row;
  int last = 0;
  while (true) {
    const std::string_view word = LineReader::Word(text);
    if (word.empty()) return row;
    const auto colon = word.find(':');
    if (colon == std::string_view::npos) {
      reader.Fail("expected index:value, not '" + LineReader::Quoted(word) + "'");
    }
    const int index =
        reader.Integer(word.substr(0, colon), "an index", 1, OneClassSvm::kMaxStateDim);
    if (index <= last) {
      reader.Fail("indices must ascend: " + std::to_string(index) + " follows " +
                  std::to_string(last));
    }
    row.entries.emplace_back(index - 1, reader.Number(word.substr(colon + 1), "a value"));
    last = index;
  }
}

core::Matrix Dense(const LineReader& reader, const std::vector<SparseRow>& rows, int width) {
  // A single large index widens every row.
  if (!core::ReadBudget(reader.bytes())
           .Take(rows.size() * sizeof(double), static_cast<std::uint64_t>(width))) {
    reader.Fail(std::to_string(rows.size()) + " rows of " + std::to_string(width) +
                " entries are too many for a file of " + std::to_string(reader.bytes()) +
                " bytes: leave out entries that are rarely used");
  }
  core::Matrix matrix = core::Matrix::Zero(static_cast<Eigen::Index>(rows.size()), width);
  for (std::size_t i = 0; i < rows.size(); ++i) {
    for (const auto& [index, value] : rows[i].entries) {
      matrix(static_cast<Eigen::Index>(i), index) = value;
    }
  }
  return matrix;
}

std::vector<double> ReadCommas(const LineReader& reader) {
  std::vector<double> values;
  std::string_view text = reader.line();
  while (true) {
    const auto comma = text.find(',');
    std::string_view cell = text.substr(0, comma);
    const std::string_view word = LineReader::Word(cell);
    values.push_back(reader.Number(word, "an entry"));
    if (!LineReader::Word(cell).empty()) reader.Fail("an entry holds more than one number");
    if (values.size() > OneClassSvm::kMaxStateDim) {
      reader.Fail("more than " + std::to_string(OneClassSvm::kMaxStateDim) + " entries");
    }
    if (comma == std::string_view::npos) return values;
    text.remove_prefix(comma + 1);
  }
}

// The first line may hold column names. A line with a cell that is meant as a number, valid or not,
// is a sample.
bool IsHeading(std::string_view line) {
  while (true) {
    const auto comma = line.find(',');
    std::string_view cell = line.substr(0, comma);
    if (core::LooksLikeNumber(LineReader::Word(cell))) return false;
    if (comma == std::string_view::npos) return true;
    line.remove_prefix(comma + 1);
  }
}

core::Matrix LoadCommas(LineReader& reader, int state_dim) {
  std::vector<double> all;
  std::size_t width = state_dim > 0 ? static_cast<std::size_t>(state_dim) : 0;
  bool first = true;
  do {
    const bool heading = first && IsHeading(reader.line());
    first = false;
    if (heading) continue;
    const std::vector<double> row = ReadCommas(reader);
    if (width == 0) width = row.size();
    if (row.size() != width) {
      reader.Fail("the sample has " + std::to_string(row.size()) + " entries, not " +
                  std::to_string(width));
    }
    all.insert(all.end(), row.begin(), row.end());
  } while (reader.Next());
  if (all.empty()) reader.Fail("there are no samples");
  return Eigen::Map<const core::Matrix>(all.data(), static_cast<Eigen::Index>(all.size() / width),
                                        static_cast<Eigen::Index>(width));
}

core::Matrix LoadSparse(LineReader& reader, int state_dim) {
  std::vector<SparseRow> rows;
  int width = 1;
  do {
    std::string_view text = reader.line();
    const std::string_view label = LineReader::Word(text);
    (void)reader.Number(label, "a label");
    rows.push_back(ReadSparse(reader, text));
    width = std::max(width, rows.back().width());
    if (state_dim > 0 && width > state_dim) {
      reader.Fail("index " + std::to_string(width) + " exceeds the number of entries, " +
                  std::to_string(state_dim));
    }
  } while (reader.Next());
  return Dense(reader, rows, state_dim > 0 ? state_dim : width);
}

// A line without comma and colon is one number, or a sparse sample of zeros.
bool IsSparse(std::istream& in, const std::string& name) {
  LineReader reader(in, name);
  while (reader.Next()) {
    if (reader.line().find(',') != std::string_view::npos) return false;
    if (reader.line().find(':') != std::string_view::npos) return true;
  }
  return false;
}

}  // namespace

void SaveLibsvmModel(const OneClassSvm& svm, const std::filesystem::path& path) {
  std::ostringstream out;
  out.precision(std::numeric_limits<double>::max_digits10);
  out << "svm_type one_class\nkernel_type rbf\ngamma " << svm.gamma() << "\nnr_class 2\ntotal_sv "
      << svm.num_support_vectors() << "\nrho " << svm.rho() * svm.libsvm_scale() << "\nSV\n";
  for (Eigen::Index i = 0; i < svm.alpha().size(); ++i) {
    out << svm.alpha()[i] * svm.libsvm_scale();
    for (Eigen::Index k = 0; k < svm.support_vectors().cols(); ++k) {
      // The last entry is written even if zero, because it gives the dimension of a state.
      const double value = svm.support_vectors()(i, k);
      if (value != 0.0 || k + 1 == svm.support_vectors().cols())
        out << ' ' << k + 1 << ':' << value;
    }
    out << " \n";
  }
  core::ReplaceFile(path, out.view());
}

OneClassSvm LoadLibsvmModel(const std::filesystem::path& path) {
  std::ifstream in = Open(path);
  return LoadLibsvmModel(in, path.string());
}

OneClassSvm LoadLibsvmModel(std::istream& in, const std::string& name) {
  LineReader reader(in, name);
  std::optional<double> gamma, rho;
  std::optional<int> total;
  bool one_class = false;
  bool gaussian = false;
  bool vectors = false;
  while (!vectors && reader.Next()) {
    std::string_view text = reader.line();
    const std::string_view key = LineReader::Word(text);
    const std::string_view value = LineReader::Word(text);
    if (key == "svm_type") {
      if (value != "one_class") {
        reader.Fail("svm_type must be one_class, not '" + LineReader::Quoted(value) + "'");
      }
      one_class = true;
    } else if (key == "kernel_type") {
      if (value != "rbf") {
        reader.Fail("kernel_type must be rbf, not '" + LineReader::Quoted(value) + "'");
      }
      gaussian = true;
    } else if (key == "gamma") {
      gamma = reader.Number(value, "gamma");
      if (*gamma <= 0.0) reader.Fail("gamma must be positive");
    } else if (key == "rho") {
      rho = reader.Number(value, "rho");
    } else if (key == "total_sv") {
      total = reader.Integer(value, "total_sv", 1, std::numeric_limits<int>::max());
    } else if (key == "nr_class") {
      (void)reader.Integer(value, "nr_class", 2, 2);
    } else if (key == "SV") {
      vectors = true;
    } else if (key != "prob_density_marks") {  // written by newer LIBSVM; g does not need it
      reader.Fail("unknown key '" + LineReader::Quoted(key) + "'");
    }
    if (key != "SV" && key != "prob_density_marks") {
      if (value.empty()) reader.Fail(std::string(key) + " has no value");
      if (!LineReader::Word(text).empty()) reader.Fail(std::string(key) + " has two values");
    }
  }
  const auto need = [&](bool present, const char* key) {
    if (!present) reader.Fail(std::string("the header has no ") + key);
  };
  need(vectors, "SV");
  need(one_class, "svm_type");
  need(gaussian, "kernel_type");
  need(gamma.has_value(), "gamma");
  need(rho.has_value(), "rho");
  need(total.has_value(), "total_sv");

  std::vector<double> alpha;
  std::vector<SparseRow> rows;
  int width = 1;
  while (reader.Next()) {
    if (static_cast<int>(rows.size()) == *total) {
      reader.Fail("more than the " + std::to_string(*total) + " support vectors of total_sv");
    }
    std::string_view text = reader.line();
    alpha.push_back(reader.Number(LineReader::Word(text), "a coefficient"));
    if (!(alpha.back() > 0.0)) reader.Fail("a coefficient must be positive");
    rows.push_back(ReadSparse(reader, text));
    width = std::max(width, rows.back().width());
  }
  if (static_cast<int>(rows.size()) != *total) {
    reader.Fail("the file ends after " + std::to_string(rows.size()) + " of " +
                std::to_string(*total) + " support vectors");
  }
  Eigen::VectorXd weights = core::AsVector(std::span<const double>(alpha));
  const double scale = weights.sum();
  if (!std::isfinite(scale)) reader.Fail("the coefficients are too large");
  weights /= scale;
  try {
    return OneClassSvm::FromParts(Dense(reader, rows, width), std::move(weights), *gamma,
                                  *rho / scale, scale);
  } catch (const std::invalid_argument& e) {
    reader.Fail(e.what());
  }
}

core::Matrix LoadSamples(const std::filesystem::path& path, int state_dim) {
  std::ifstream in = Open(path);
  CheckFitsMemory(path);
  const bool sparse = IsSparse(in, path.string());
  in.clear();
  in.seekg(0);
  if (!in) throw std::runtime_error(path.string() + ": must be a regular file, not a pipe");
  LineReader reader(in, path.string());
  if (!reader.Next()) reader.Fail("the file is empty");
  return sparse ? LoadSparse(reader, state_dim) : LoadCommas(reader, state_dim);
}

}  // namespace dfr::kernel
