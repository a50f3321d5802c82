// Damaged archives, and archives with a valid checksum around arbitrary values.
#include <algorithm>
#include <stdexcept>
#include <string>

#include "dfr/core/files/archive.h"
#include "tests/fuzz/input_file.h"
#include "tests/fuzz/target.h"

namespace {

void Read(const std::filesystem::path& path, std::string_view order) {
  try {
    dfr::core::ArchiveReader reader(path, "sample", 2);
    for (const char c : order) {
      switch (c % 7) {
        case 0:
          static_cast<void>(reader.Integer());
          break;
        case 1:
          static_cast<void>(reader.Number());
          break;
        case 2:
          static_cast<void>(reader.Text());
          break;
        case 3:
          static_cast<void>(reader.Numbers());
          break;
        case 4:
          static_cast<void>(reader.Integers());
          break;
        case 5:
          static_cast<void>(reader.MatrixBlock());
          break;
        default:
          static_cast<void>(reader.IntegerIn(-1, 1));
      }
    }
    reader.End();
  } catch (const std::runtime_error&) {  // NOLINT(bugprone-empty-catch): expected for bad input
  }
}

}  // namespace

DFR_FUZZ_TARGET(archive) {
  const std::string_view input = dfr::fuzz::AsText(data, size);
  const std::size_t order = size > 0 ? std::min<std::size_t>(data[0] % 8U, size - 1) : 0;
  const std::string_view types = input.substr(std::min<std::size_t>(1, size), order);
  Read(dfr::fuzz::InputFile(input), types);
  const std::string_view values = input.substr(std::min(size, 1 + order));
  Read(dfr::fuzz::InputFile(dfr::fuzz::Archive("sample", 2, values)), types);
  return 0;
}
