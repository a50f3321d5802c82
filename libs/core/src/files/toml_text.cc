#include "dfr/core/files/toml_text.h"

#include <algorithm>
#include <array>
#include <cstddef>
#include <fstream>
#include <stdexcept>
#include <string>
#include <system_error>
#include <utility>

#include "dfr/core/files/read_file.h"
#include "dfr/core/text/format.h"

namespace dfr::core {
namespace {

constexpr std::string_view kByteOrderMark = "\xEF\xBB\xBF";
constexpr std::string_view kDigits = "0123456789";
constexpr std::string_view kOfNames =
    "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789_-";
constexpr std::string_view kOfWords =
    "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789_-+.:";
constexpr std::size_t kDeepest = 32;  // Maximum nesting of brackets.

std::size_t EndOf(std::string_view characters, std::string_view text, std::size_t begin) noexcept {
  return std::min(text.find_first_not_of(characters, begin), text.size());
}

bool IsTriple(std::string_view text, std::size_t begin) noexcept {
  return text.substr(begin).starts_with(text[begin] == '"' ? "\"\"\"" : "'''");
}

// Returns the end (one past the last quote) of the string that starts at `begin`; npos if it is not
// closed.
std::size_t EndOfString(std::string_view text, std::size_t begin) noexcept {
  const char quote = text[begin];
  const bool triple = IsTriple(text, begin);
  int quotes = 0;  // Consecutive quotes. Up to two may precede the closing three.
  for (std::size_t i = begin + (triple ? 3 : 1); i < text.size(); ++i) {
    const char c = text[i];
    if (triple && quotes >= 3 && c != quote) return i;
    quotes = c == quote ? quotes + 1 : 0;
    if (quotes == (triple ? 5 : 1)) return i + 1;
    if (c == '\\' && quote == '"') ++i;
    if (!triple && i < text.size() && text[i] == '\n') break;
  }
  return quotes >= 3 ? text.size() : std::string_view::npos;
}

// Returns the end of the digits from `begin` on, with single underscores between them; `begin` if
// there are none.
std::size_t EndOfDigits(std::string_view word, std::size_t begin) noexcept {
  std::size_t i = EndOf(kDigits, word, begin);
  while (i > begin && i + 1 < word.size() && word[i] == '_' &&
         kDigits.find(word[i + 1]) != std::string_view::npos) {
    i = EndOf(kDigits, word, i + 1);
  }
  return i;
}

std::size_t EndOfSign(std::string_view word, std::size_t begin) noexcept {
  return begin < word.size() && (word[begin] == '+' || word[begin] == '-') ? begin + 1 : begin;
}

bool IsValue(std::string_view word) noexcept {
  if (word == "true" || word == "false") return true;
  const std::size_t whole = EndOfSign(word, 0);
  if (word.substr(whole) == "inf" || word.substr(whole) == "nan") return true;
  std::size_t end = EndOfDigits(word, whole);
  if (end == whole) return false;
  for (const char* mark : {".", "eE"}) {
    if (end == word.size() || std::string_view(mark).find(word[end]) == std::string_view::npos) {
      continue;
    }
    const std::size_t digits = mark[0] == '.' ? end + 1 : EndOfSign(word, end + 1);
    end = EndOfDigits(word, digits);
    if (end == digits) return false;
  }
  return end == word.size();
}

struct Fault {
  std::size_t at;
  const char* what;  // Null if there is no fault.
};

// Next expected token. A name is a key's or table's name, or one dotted part of it.
enum class Next { kLine, kName, kNameOrEnd, kAfterName, kValue, kEnd };

constexpr const char* WhatIsNeeded(Next next) noexcept {
  switch (next) {
    case Next::kLine:
      return "a line must begin with a name, as in  speed = 0.005, or with a table, as in  [arm]";
    case Next::kName:
    case Next::kNameOrEnd:
      return "there must be a name: letters, digits, - and _, or a string in quotes";
    case Next::kAfterName:
      return "a name must be followed by = and a value, and a table's name by the brackets that "
             "it began with, on the same line";
    case Next::kValue:
      return "there must be a value: a decimal number, true, false, a string in quotes, a list in "
             "[ ] or a table in { }";
    case Next::kEnd:
      break;
  }
  return "a value must be followed by the end of its line, by a comma in a list, or by the bracket "
         "that closes the list";
}

// Finds the first fault outside quotes and comments. Dates and non-decimal numbers are faults too:
// no configuration needs them.
Fault FindFault(std::string_view text) noexcept {
  std::array<std::size_t, kDeepest> open{};  // Brackets that are still open.
  std::size_t depth = 0;
  std::size_t header = 0;  // Number of brackets that close the table's name; 0 outside a header.
  Next next = Next::kLine;
  std::size_t i = text.starts_with(kByteOrderMark) ? kByteOrderMark.size() : 0;
  while (i < text.size()) {
    const char c = text[i];
    const char top = depth > 0 ? text[open[depth - 1]] : '\0';
    const bool named = next == Next::kLine || next == Next::kName || next == Next::kNameOrEnd;
    if (c == ' ' || c == '\t' || (c == '\r' && text.substr(i).starts_with("\r\n"))) {
      ++i;
    } else if (c == '#') {
      i = std::min(text.find('\n', i), text.size());
    } else if (c == '\n') {
      if (depth == 0 && next == Next::kEnd) next = Next::kLine;
      if (top != '[' && next != Next::kLine) return {i, WhatIsNeeded(next)};
      ++i;
    } else if (static_cast<unsigned char>(c) >= 0x80) {
      return {i, "a character beyond ASCII must stand in quotes or in a comment"};
    } else if (next == Next::kLine && c == '[') {
      header = text.substr(i).starts_with("[[") ? 2 : 1;
      i += header;
      next = Next::kName;
    } else if ((named || next == Next::kValue) && (c == '"' || c == '\'')) {
      if (named && IsTriple(text, i)) return {i, WhatIsNeeded(next)};
      const std::size_t end = EndOfString(text, i);
      if (end == std::string_view::npos) return {i, "the quotes that begin here are not closed"};
      i = end;
      next = named ? Next::kAfterName : Next::kEnd;
    } else if (named && kOfNames.find(c) != std::string_view::npos) {
      i = EndOf(kOfNames, text, i);
      next = Next::kAfterName;
    } else if (next == Next::kAfterName && c == '.') {
      ++i;
      next = Next::kName;
    } else if (next == Next::kAfterName && c == '=' && header == 0) {
      ++i;
      next = Next::kValue;
    } else if (next == Next::kAfterName && header > 0 &&
               text.substr(i).starts_with(std::string_view("]]").substr(0, header))) {
      i += header;
      header = 0;
      next = Next::kEnd;
    } else if (next == Next::kValue && (c == '[' || c == '{')) {
      if (depth == kDeepest) return {i, "brackets are nested more than 32 deep"};
      open[depth++] = i++;
      next = c == '{' ? Next::kNameOrEnd : Next::kValue;
    } else if ((top == '[' && c == ']' && (next == Next::kValue || next == Next::kEnd)) ||
               (top == '{' && c == '}' && (next == Next::kNameOrEnd || next == Next::kEnd))) {
      --depth;
      ++i;
      next = Next::kEnd;
    } else if (next == Next::kEnd && c == ',' && depth > 0) {
      ++i;
      next = top == '[' ? Next::kValue : Next::kName;
    } else if (next == Next::kValue && kOfWords.find(c) != std::string_view::npos) {
      const std::size_t end = EndOf(kOfWords, text, i);
      if (!IsValue(text.substr(i, end - i))) return {i, WhatIsNeeded(next)};
      i = end;
      next = Next::kEnd;
    } else {
      return {i, WhatIsNeeded(next)};
    }
  }
  if (depth > 0) return {open[depth - 1], "the bracket that opens here is not closed"};
  if (next != Next::kLine && next != Next::kEnd) return {text.size(), WhatIsNeeded(next)};
  return {text.size(), nullptr};
}

// Appends the non-ASCII character at `at` (a whole UTF-8 sequence) as an escape. Returns its end.
std::size_t Escape(std::string_view text, std::size_t at, std::string& out) {
  constexpr std::string_view kHexadecimal = "0123456789abcdef";
  const auto first = static_cast<unsigned char>(text[at]);
  const std::size_t length = first < 0xe0 ? 2 : first < 0xf0 ? 3 : 4;
  unsigned point = first & (0x7fU >> length);
  for (std::size_t k = 1; k < length; ++k) {
    point = (point << 6U) | (static_cast<unsigned char>(text[at + k]) & 0x3fU);
  }
  const bool wide = point > 0xffff;
  out += wide ? "\\U" : "\\u";
  for (unsigned digits = wide ? 8 : 4; digits > 0; --digits) {
    out += kHexadecimal[(point >> (4 * (digits - 1))) & 0xfU];
  }
  return at + length;
}

bool IsAscii(char c) noexcept { return static_cast<unsigned char>(c) < 0x80; }

// Appends the string `whole`, quotes included, as a basic ASCII string.
void AppendString(std::string_view whole, std::string& out) {
  const bool literal = whole[0] == '\'';
  const std::string_view triple = literal ? "'''" : "\"\"\"";
  const std::string_view quotes = whole.starts_with(triple) ? triple : triple.substr(0, 1);
  const std::size_t end = whole.size() - quotes.size();
  out.append(quotes.size(), '"');
  for (std::size_t i = quotes.size(); i < end;) {
    const char c = whole[i];
    if (!IsAscii(c)) {
      i = Escape(whole, i, out);
    } else if (c == '\\' && !literal) {
      // An invalid escape stays invalid; the parser reports it.
      const bool escapes = i + 1 < end && IsAscii(whole[i + 1]);
      out += c;
      out += escapes ? whole[i + 1] : '?';
      i += escapes ? 2 : 1;
    } else {
      if (literal && (c == '"' || c == '\\')) out += '\\';
      out += c;
      ++i;
    }
  }
  out.append(quotes.size(), '"');
}

// Returns the text in ASCII: non-ASCII characters become escapes in strings and are removed from
// comments. `text` must be free of faults.
std::string InAscii(std::string_view text) {
  std::string out;
  std::size_t i = text.starts_with(kByteOrderMark) ? kByteOrderMark.size() : 0;
  while (i < text.size()) {
    if (text[i] == '#') {
      for (; i < text.size() && text[i] != '\n'; ++i) {
        if (IsAscii(text[i])) out += text[i];
      }
    } else if (text[i] == '"' || text[i] == '\'') {
      const std::string_view whole = text.substr(i, EndOfString(text, i) - i);
      if (std::all_of(whole.begin(), whole.end(), IsAscii)) {
        out += whole;
      } else {
        AppendString(whole, out);
      }
      i += whole.size();
    } else {
      out += text[i++];
    }
  }
  return out;
}

}  // namespace

std::string CheckToml(const std::filesystem::path& file, std::string_view text) {
  constexpr std::size_t kMost = 1 << 20;
  const auto fail = [&](std::size_t at, const std::string& what) {
    const auto line =
        1 + std::count(text.begin(), text.begin() + static_cast<std::ptrdiff_t>(at), '\n');
    throw std::runtime_error(file.string() + ":" + std::to_string(line) + ": " + what);
  };
  const std::string whole_file = "; check that this is a configuration file";
  if (text.size() > kMost) fail(0, "the file is longer than a mebibyte" + whole_file);
  for (std::size_t i = 0; i < text.size();) {
    const auto byte = static_cast<unsigned char>(text[i]);
    if ((byte < 0x20 && byte != '\t' && byte != '\n' && byte != '\r') || byte == 0x7f) {
      fail(i, "there is the control character " + std::to_string(byte) + whole_file);
    }
    const std::size_t length = Utf8Size(text.substr(i));
    if (length == 0) fail(i, "there is a character that is not UTF-8" + whole_file);
    i += length;
  }
  if (const Fault fault = FindFault(text); fault.what != nullptr) fail(fault.at, fault.what);
  return InAscii(text);
}

std::string ReadTomlText(const std::filesystem::path& file) {
  std::error_code error;
  const std::filesystem::file_status status = std::filesystem::status(file, error);
  if (std::filesystem::is_directory(status)) {
    throw std::runtime_error(file.string() + ": is a folder; name a file in it");
  }
  if (std::filesystem::is_character_file(status) || std::filesystem::is_block_file(status)) {
    throw std::runtime_error(file.string() + ": is a device; name a file");
  }
  std::ifstream in(file, std::ios::binary);
  if (!in) throw std::runtime_error(file.string() + ": cannot be read");
  std::string text;
  AppendRest(in, file, text);
  return text;
}

}  // namespace dfr::core
