// Builds a JSON text, field by field, in the order of the calls.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace rt_tests {

class Json {
 public:
  Json& open(char bracket);   // '{' or '['
  Json& close();              // closes the bracket opened last
  Json& key(const std::string& name);
  Json& value(const std::string& text);
  Json& value(const char* text) { return value(std::string(text)); }
  Json& value(int64_t number) { return raw(std::to_string(number)); }
  Json& value(int number) { return value(int64_t{number}); }
  Json& value(bool truth) { return raw(truth ? "true" : "false"); }
  Json& value(double number);  // finite; to the millionth
  Json& null() { return raw("null"); }

  template <class Value>
  Json& value(const std::optional<Value>& content) {
    return content ? value(*content) : null();
  }
  template <class Value>
  Json& field(const std::string& name, const Value& content) {
    return key(name).value(content);
  }
  template <class Value>
  Json& value(const std::vector<Value>& items) {
    open('[');
    for (const auto& item : items) value(item);
    return close();
  }

  std::string text() const { return text_ + "\n"; }

 private:
  Json& raw(const std::string& token);
  void separate();

  std::string text_;
  std::vector<char> closing_;
  bool first_ = true;
  bool after_key_ = false;
};

// In quotes, escaped; bytes that are not UTF-8 become U+FFFD.
std::string json_string(const std::string& bytes);

}  // namespace rt_tests
