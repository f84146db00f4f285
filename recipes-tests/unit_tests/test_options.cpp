#include <gtest/gtest.h>

#include <stdexcept>

#include "rt_tests_support/errors.h"
#include "rt_tests_support/options.h"

using namespace rt_tests;

namespace {

const Program program = {"suite", "program", "Does it.",
                         {"policy", "repetitions", "prefix", "timeout_us", "priority", "cpu", "break_trace_us"}};

Options parsed(std::vector<std::string> words) {
  words.insert(words.begin(), "program");
  std::vector<char*> argv;
  for (auto& word : words) argv.push_back(word.data());
  return parse(program, static_cast<int>(argv.size()), argv.data());
}

std::string refusal(const std::vector<std::string>& words) {
  try {
    parsed(words);
  } catch (const UsageError& error) {
    return error.what();
  }
  return "accepted";
}

}  // namespace

TEST(Options, DefaultsAreThoseOf2014) {
  const Options options = parsed({});
  EXPECT_EQ(options.text("policy"), "0");
  EXPECT_EQ(options.number("repetitions"), 1000);
  EXPECT_EQ(options.number("timeout_us"), 1000);
  EXPECT_EQ(options.text("prefix"), "");
  EXPECT_EQ(options.number("priority"), 95);
  EXPECT_FALSE(options.given("break_trace_us"));
}

TEST(Options, ShortAndLongFormsAndRosRemappings) {
  const Options options = parsed({"-s", "RR", "__name:=x", "-p", "", "--priority=42", "-r", "7", "-r", "8", "a:=b"});
  EXPECT_EQ(options.text("policy"), "RR");
  EXPECT_EQ(options.number("priority"), 42);
  EXPECT_EQ(options.number("repetitions"), 8);  // the last one counts, as in 2014
}

TEST(Options, AnUnknownKeyIsADefectThatSaysSo) {
  EXPECT_THROW(parsed({}).number("payload_bytes"), std::logic_error);
  EXPECT_THROW(parsed({}).text("clok"), std::logic_error);
  EXPECT_THROW(Options({"suite", "program", "", {"clok"}}), std::logic_error);
}

TEST(Options, RefusalsNameTheOptionAndWhatItTakes) {
  EXPECT_EQ(refusal({"-r", "-5"}), "-r takes an integer from 1 to 100000000, got '-5'");
  EXPECT_EQ(refusal({"-r", "100000001"}), "-r takes an integer from 1 to 100000000, got '100000001'");
  EXPECT_EQ(refusal({"-r", "99999999999999999999"}), "-r takes an integer from 1 to 100000000, got '99999999999999999999'");
  for (const char* text : {"", "abc", "1k", "1.5", " 1", "0x10", "--", "+1"}) {
    EXPECT_EQ(refusal({"-r", text}), std::string("-r takes an integer from 1 to 100000000, got '") + text + "'");
  }
  EXPECT_EQ(refusal({"-r"}), "-r takes 1..100000000, got nothing");
  EXPECT_EQ(refusal({"-s", "rr"}), "-s takes 0|RR|FIFO, got 'rr'");
  EXPECT_EQ(refusal({"-s"}), "-s takes 0|RR|FIFO, got nothing");
  EXPECT_EQ(refusal({"-f", "1000"}), "unknown option '-f'; program --help lists what there is");
  EXPECT_EQ(refusal({"word"}), "unknown option 'word'; program --help lists what there is");
  EXPECT_EQ(refusal({"-r=5"}), "unknown option '-r=5'; program --help lists what there is");
  EXPECT_EQ(refusal({"--priority", "99"}), "--priority takes an integer from 1 to 98, got '99'");
  EXPECT_NE(refusal({"--cpu", "4096"}).find("--cpu takes CPUs of this machine"), std::string::npos);
}

TEST(Options, CpuLists) {
  EXPECT_EQ(parse_cpus("0", 4), std::vector<int>({0}));
  EXPECT_EQ(parse_cpus("0-2", 4), std::vector<int>({0, 1, 2}));
  EXPECT_EQ(parse_cpus("3,0-1", 4), std::vector<int>({3, 0, 1}));
  for (const char* wrong : {"", "4", "-1", "1-", "2-1", "0,", ",0", "a", "0-9", "0 1", "99999999999"}) {
    EXPECT_THROW(parse_cpus(wrong, 4), UsageError) << wrong;
  }
}
