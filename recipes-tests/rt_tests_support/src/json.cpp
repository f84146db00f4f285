#include "rt_tests_support/json.h"

#include <cstdio>
#include <iomanip>
#include <locale>
#include <sstream>

namespace rt_tests {
namespace {

// Length of the UTF-8 sequence at `at`, 0 if there is none.
std::size_t sequence_length(const std::string& bytes, std::size_t at) {
  const auto byte = [&](std::size_t i) { return i < bytes.size() ? static_cast<unsigned char>(bytes[i]) : 0u; };
  const unsigned first = byte(at);
  const std::size_t length =
      first < 0x80 ? 1 : first < 0xc2 ? 0 : first < 0xe0 ? 2 : first < 0xf0 ? 3 : first < 0xf5 ? 4 : 0;
  for (std::size_t i = 1; i < length; ++i) {
    if ((byte(at + i) & 0xc0) != 0x80) return 0;
  }
  // Overlong forms, surrogates and what lies above U+10FFFF.
  const unsigned second = byte(at + 1);
  if ((first == 0xe0 && second < 0xa0) || (first == 0xed && second > 0x9f) || (first == 0xf0 && second < 0x90) ||
      (first == 0xf4 && second > 0x8f)) {
    return 0;
  }
  return length;
}

}  // namespace

std::string json_string(const std::string& bytes) {
  std::string text = "\"";
  for (std::size_t at = 0; at < bytes.size();) {
    const char c = bytes[at];
    const std::size_t length = sequence_length(bytes, at);
    if (length == 0) {
      text += "\\ufffd";
    } else if (c == '"' || c == '\\') {
      text += std::string("\\") + c;
    } else if (length == 1 && static_cast<unsigned char>(c) < 0x20) {
      char escape[8];
      std::snprintf(escape, sizeof escape, "\\u%04x", static_cast<unsigned>(c));
      text += escape;
    } else {
      text += bytes.substr(at, length);
    }
    at += length == 0 ? 1 : length;
  }
  return text + "\"";
}

void Json::separate() {
  if (!first_ && !after_key_) text_ += ",";
  // One line for each field of the outer two levels: readable, and greppable on a board without jq.
  if (!after_key_ && !closing_.empty() && closing_.size() <= 2) text_ += "\n" + std::string(2 * closing_.size(), ' ');
  else if (!first_ && !after_key_) text_ += " ";
  first_ = false;
  after_key_ = false;
}

Json& Json::value(double number) {
  std::ostringstream text;
  text.imbue(std::locale::classic());
  text << std::fixed << std::setprecision(6) << number;
  return raw(text.str());
}

Json& Json::raw(const std::string& token) {
  separate();
  text_ += token;
  return *this;
}

Json& Json::open(char bracket) {
  separate();
  text_ += bracket;
  closing_.push_back(bracket == '{' ? '}' : ']');
  first_ = true;
  return *this;
}

Json& Json::close() {
  const char bracket = closing_.back();
  closing_.pop_back();
  if (!first_ && closing_.size() < 2) text_ += "\n" + std::string(2 * closing_.size(), ' ');
  text_ += bracket;
  first_ = false;
  return *this;
}

Json& Json::key(const std::string& name) {
  separate();
  text_ += json_string(name) + ": ";
  after_key_ = true;
  return *this;
}

Json& Json::value(const std::string& text) { return raw(json_string(text)); }

}  // namespace rt_tests
