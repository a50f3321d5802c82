#include "dfr/core/toml_text.h"

#include <algorithm>
#include <cstddef>
#include <stdexcept>
#include <string>

namespace dfr::core {
namespace {

constexpr std::string_view kBeginsName =
    "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789_-\"'";
constexpr std::string_view kBeforeString = " \t\r\n=,[{.\xBF";
constexpr std::string_view kByteOrderMark = "\xEF\xBB\xBF";

// Where the string that begins at `begin` ends, one past its last quote.
std::size_t EndOfString(std::string_view text, std::size_t begin) noexcept {
  const char quote = text[begin];
  const bool triple = text.substr(begin).starts_with(quote == '"' ? "\"\"\"" : "'''");
  int quotes = 0;
  for (std::size_t i = begin + (triple ? 3 : 1); i < text.size(); ++i) {
    const char c = text[i];
    if (triple && quotes >= 3 && c != quote) return i;
    quotes = c == quote ? quotes + 1 : 0;
    if (quotes == 1 && !triple) return i + 1;
    if (c == '\n' && !triple) return i;  // It is not closed, as the parser will say.
    if (c == '\\' && quote == '"') ++i;
  }
  return text.size();
}

struct Fault {
  std::size_t at;  // Or the end.
  const char* what;
};

// What is outside quotes and comments, and TOML does not allow there.
Fault FindFault(std::string_view text) noexcept {
  std::size_t i = text.starts_with(kByteOrderMark) ? kByteOrderMark.size() : 0;
  int depth = 0;  // Arrays and inline tables that are open.
  bool begins = true;
  while (i < text.size()) {
    const char c = text[i];
    if (c == '#') {
      i = std::min(text.find('\n', i), text.size());
    } else if (c == '"' || c == '\'') {
      if (i > 0 && kBeforeString.find(text[i - 1]) == std::string_view::npos) {
        return {i, "a quote must not stand in the middle of a word"};
      }
      i = EndOfString(text, i);
      begins = false;
    } else if (static_cast<unsigned char>(c) >= 0x80) {
      return {i, "a character beyond ASCII must stand in quotes or in a comment"};
    } else if (c == '[' && begins && depth == 0) {
      const std::size_t inner = text.substr(i).starts_with("[[") ? i + 2 : i + 1;
      const std::size_t name = std::min(text.find_first_not_of(" \t", inner), text.size());
      if (name == text.size() || kBeginsName.find(text[name]) == std::string_view::npos) {
        return {i, "the name of a table must follow its bracket in the same line"};
      }
      i = name;
      begins = false;
    } else {
      if (c == '[' || c == '{') ++depth;
      if (c == ']' || c == '}') depth = std::max(0, depth - 1);
      begins = c == '\n' || (begins && (c == ' ' || c == '\t'));
      ++i;
    }
  }
  return {i, ""};
}

// Appends a character beyond ASCII, the whole UTF-8 sequence at `at`, as an escape. Returns its
// end.
std::size_t Escape(std::string_view text, std::size_t at, std::string& out) {
  constexpr std::string_view kDigits = "0123456789abcdef";
  const auto first = static_cast<unsigned char>(text[at]);
  const std::size_t length = first < 0xe0 ? 2 : first < 0xf0 ? 3 : 4;
  unsigned point = first & (0x7fU >> length);
  for (std::size_t k = 1; k < length; ++k) {
    point = (point << 6U) | (static_cast<unsigned char>(text[at + k]) & 0x3fU);
  }
  const bool wide = point > 0xffff;
  out += wide ? "\\U" : "\\u";
  for (unsigned digits = wide ? 8 : 4; digits > 0; --digits) {
    out += kDigits[(point >> (4 * (digits - 1))) & 0xfU];
  }
  return at + length;
}

bool IsAscii(char c) noexcept { return static_cast<unsigned char>(c) < 0x80; }

// The string `whole`, quotes included, as a basic one in ASCII.
void AppendString(std::string_view whole, std::string& out) {
  const bool literal = whole[0] == '\'';
  const std::string_view triple = literal ? "'''" : "\"\"\"";
  const std::string_view quotes = whole.starts_with(triple) ? triple : triple.substr(0, 1);
  const bool closed = whole.size() >= 2 * quotes.size() && whole.ends_with(quotes);
  const std::size_t end = closed ? whole.size() - quotes.size() : whole.size();
  out.append(quotes.size(), '"');
  for (std::size_t i = quotes.size(); i < end;) {
    const char c = whole[i];
    if (!IsAscii(c)) {
      i = Escape(whole, i, out);
    } else if (c == '\\' && !literal) {
      // What is no escape stays none, as the parser will say.
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
  if (closed) out.append(quotes.size(), '"');
}

// The same text in ASCII: characters beyond it become escapes in strings, and are left out of
// comments. `text` is without a fault.
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
  const std::string whole_file = "; is this a configuration, and is it whole?";
  if (text.size() > kMost) fail(0, "the file is longer than a mebibyte" + whole_file);
  for (std::size_t i = 0; i < text.size();) {
    const auto byte = static_cast<unsigned char>(text[i]);
    if ((byte < 0x20 && byte != '\t' && byte != '\n' && byte != '\r') || byte == 0x7f) {
      fail(i, "there is the control character " + std::to_string(byte) + whole_file);
    }
    const std::size_t length = byte < 0x80                   ? 1
                               : byte >= 0xc2 && byte < 0xe0 ? 2
                               : byte >= 0xe0 && byte < 0xf0 ? 3
                               : byte >= 0xf0 && byte < 0xf5 ? 4
                                                             : 0;
    bool whole = length > 0 && length <= text.size() - i;
    for (std::size_t k = 1; whole && k < length; ++k) {
      whole = (static_cast<unsigned char>(text[i + k]) & 0xc0U) == 0x80;
    }
    if (!whole) fail(i, "there is a character that is not UTF-8" + whole_file);
    i += length;
  }
  if (const Fault fault = FindFault(text); fault.at < text.size()) fail(fault.at, fault.what);
  return InAscii(text);
}

}  // namespace dfr::core
