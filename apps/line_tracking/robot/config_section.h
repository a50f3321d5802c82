#pragma once

#include <toml++/toml.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <map>
#include <span>
#include <sstream>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "dfr/kinematics/psm.h"

namespace dfr::apps::line_tracking {

/// @throws std::runtime_error naming file and line.
[[noreturn]] inline void Fail(const std::filesystem::path& file, const toml::source_region& where,
                              const std::string& what) {
  throw std::runtime_error(file.string() + ":" + std::to_string(where.begin.line) + ": " + what);
}

/// A table of a configuration file. Get() sets a value if its key is present. End() rejects each
/// key that no call of Get() has read.
class Section {
 public:
  Section(const std::filesystem::path& file, const toml::table& table, std::string name)
      : file_(file), table_(table), name_(std::move(name)) {}

  void Get(const char* key, std::string& value) {
    if (const toml::node* node = Find(key)) {
      const auto text = node->value_exact<std::string>();
      if (!text) Wrong(*node, key, "a string in quotes");
      value = *text;
    }
  }
  void Get(const char* key, std::filesystem::path& value) {
    std::string text = value.string();
    Get(key, text);
    value = text;
  }
  void Get(const char* key, bool& value) {
    if (const toml::node* node = Find(key)) {
      const auto flag = node->value_exact<bool>();
      if (!flag) Wrong(*node, key, "true or false");
      value = *flag;
    }
  }
  void Get(const char* key, double& value, double lowest, double highest) {
    if (const toml::node* node = Find(key)) {
      const auto number = node->value<double>();
      if (!number || !(*number >= lowest && *number <= highest)) {
        std::ostringstream range;
        range << "a number in [" << lowest << ", " << highest << "]";
        Wrong(*node, key, range.str());
      }
      value = *number;
    }
  }
  void Get(const char* key, int& value, int lowest, int highest) {
    if (const toml::node* node = Find(key)) {
      const auto number = node->value_exact<std::int64_t>();
      if (!number || *number < lowest || *number > highest) {
        Wrong(
            *node, key,
            "a whole number in [" + std::to_string(lowest) + ", " + std::to_string(highest) + "]");
      }
      value = static_cast<int>(*number);
    }
  }
  /// Returns false if the key is missing.
  bool Get(const char* key, std::span<double> values) {
    const toml::node* node = Find(key);
    if (node == nullptr) return false;
    const std::string wanted = std::to_string(values.size()) + " numbers in brackets";
    const toml::array* array = node->as_array();
    if (array == nullptr || array->size() != values.size()) Wrong(*node, key, wanted);
    for (std::size_t i = 0; i < values.size(); ++i) {
      const auto number = (*array)[i].value<double>();
      if (!number || std::isnan(*number)) Wrong(*node, key, wanted);
      values[i] = *number;
    }
    return true;
  }
  /// Reads joint values, which must be positive.
  void Get(const char* key, kinematics::PsmJoints& values) {
    if (!Get(key, {values.data(), 6})) return;
    if (!values.allFinite() || !(values.array() > 0.0).all()) {
      Wrong(key, "6 positive numbers in brackets: rad (insertion: m)");
    }
  }
  void Get(const char* key, std::vector<std::string>& values) {
    const toml::node* node = Find(key);
    if (node == nullptr) return;
    const toml::array* array = node->as_array();
    values.clear();
    for (std::size_t i = 0; array != nullptr && i < array->size(); ++i) {
      values.push_back((*array)[i].value_exact<std::string>().value_or(""));
    }
    const auto topic = [](const std::string& name) {
      return name.size() > 1 && name.front() == '/';
    };
    if (values.empty() || !std::ranges::all_of(values, topic)) {
      Wrong(*node, key, "names of topics in brackets, each with a slash in front");
    }
  }
  /// Returns rows of `columns` numbers each; no row if the key is missing.
  [[nodiscard]] std::vector<std::vector<double>> Rows(const char* key, std::size_t columns,
                                                      const char* meaning) {
    std::vector<std::vector<double>> rows;
    const toml::node* node = Find(key);
    if (node == nullptr) return rows;
    const std::string wanted = std::string("a list of ") + meaning + ", each " +
                               std::to_string(columns) + " finite numbers in brackets";
    const toml::array* array = node->as_array();
    if (array == nullptr) Wrong(*node, key, wanted);
    for (const toml::node& entry : *array) {
      const toml::array* row = entry.as_array();
      if (row == nullptr || row->size() != columns) Wrong(entry, key, wanted);
      rows.emplace_back();
      for (const toml::node& number : *row) {
        rows.back().push_back(number.value<double>().value_or(std::nan("")));
        if (!std::isfinite(rows.back().back())) Wrong(entry, key, wanted);
      }
    }
    return rows;
  }
  template <typename T>
  void Get(const char* key, T& value, const std::map<std::string, T>& words) {
    const toml::node* node = Find(key);
    if (node == nullptr) return;
    const auto text = node->value_exact<std::string>();
    const auto found = text ? words.find(*text) : words.end();
    if (found == words.end()) {
      std::string all;
      for (const auto& [word, meaning] : words) {
        all += (all.empty() ? "\"" : ", \"") + word + "\"";
      }
      Wrong(*node, key, "one of " + all);
    }
    value = found->second;
  }
  [[nodiscard]] const toml::table* Table(const char* key) {
    const toml::node* node = Find(key);
    if (node == nullptr) return nullptr;
    if (!node->is_table()) Wrong(*node, key, "a table: [" + std::string(key) + "]");
    return node->as_table();
  }

  void End() const {
    for (const auto& [key, node] : table_) {
      if (std::find(known_.begin(), known_.end(), key.str()) != known_.end()) continue;
      std::string all;
      for (const std::string& known : known_) all += (all.empty() ? "" : ", ") + known;
      Fail(file_, node.source(),
           "unknown key '" + Full(std::string(key.str()).c_str()) + "'" +
               (name_.empty() ? "" : " in [" + name_ + "]") + "; valid: " + all);
    }
  }

  /// @throws std::runtime_error: "FILE:LINE: KEY must be WANTED".
  [[noreturn]] void Wrong(const toml::node& node, const char* key,
                          const std::string& wanted) const {
    Fail(file_, node.source(), Full(key) + " must be " + wanted);
  }
  [[noreturn]] void Wrong(const char* key, const std::string& wanted) const {
    const toml::node* node = table_.get(key);
    Wrong(node != nullptr ? *node : table_, key, wanted);
  }

 private:
  [[nodiscard]] std::string Full(const char* key) const {
    return name_.empty() ? key : name_ + "." + key;
  }
  const toml::node* Find(const char* key) {
    known_.emplace_back(key);
    return table_.get(key);
  }

  const std::filesystem::path& file_;
  const toml::table& table_;
  std::string name_;
  std::vector<std::string> known_;
};

}  // namespace dfr::apps::line_tracking
