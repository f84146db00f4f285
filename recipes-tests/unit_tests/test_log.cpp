#include <gtest/gtest.h>

#include <algorithm>

#include "rt_tests_support/log.h"

using namespace rt_tests;

namespace {

std::string log_of(Plot plot, const std::vector<int64_t>& values_us) {
  Series series("x");
  for (std::size_t i = 0; i < values_us.size(); ++i) series.add(values_us[i] * 1000, static_cast<int64_t>(i));
  return gnuplot_log(plot, "title", "name", series, {"summary"});
}

std::string data_of(const std::string& log) { return log.substr(log.find("# summary\n") + 10); }

bool has(const std::string& text, const std::string& part) { return text.find(part) != std::string::npos; }

}  // namespace

TEST(Log, IsThatOf2014ByteForByte) {
  EXPECT_EQ(log_of(Plot::communication, {2, 3, 3}),
            "set title \"title\"\n"
            "set xlabel \"Latency in micro seconds - MIN:  2us  AVG: 2us MAX: 3us\"\n"
            "set ylabel \"Number of latency samples\"\n"
            "set yrange [0.7:]\n"
            "set logscale y\n"
            "set xrange [1:53]\n"
            "set xtics add(500, 1000)\n"
            "set terminal jpeg size 1920,1080\n"
            "set output \"name.jpg\"\n"
            "plot \"-\" u 1:2 t 'Latency_Occurrence' w steps\n"
            "# Plot data for gnuplot\n"
            "# summary\n"
            "000000 \t000000\n"
            "000001 \t000000\n"
            "000002 \t000001\n"
            "000003 \t000002\n"
            "\n"
            "end\n");
}

TEST(Log, CyclicHasNegativeBinsFirst) {
  const std::string log = log_of(Plot::cyclic, {-2, 1});
  EXPECT_EQ(data_of(log), "-000002 \t000001\n-000001 \t000000\n000000 \t000000\n000001 \t000001\n\nend\n");
  EXPECT_TRUE(has(log, "set xlabel \"Jitter in micro seconds - MIN:  -2us  AVG: 0us MAX: 1us\"\n"));
  EXPECT_TRUE(has(log, "set ylabel \"Number of samples\"\n"));
  EXPECT_TRUE(has(log, "set xrange [-200:200]\n"));
  EXPECT_TRUE(has(log_of(Plot::cyclic, {-961, 170}), "set xrange [-1011:1011]\n"));
}

TEST(Log, OneshotHasNegativeBinsAsCommentsBehind) {
  const std::string log = log_of(Plot::oneshot, {-2, 1});
  EXPECT_EQ(data_of(log),
            "000000 \t000000\n000001 \t000001\n# negative Values following\n#-000002 \t000001\n#-000001 \t000000\n\nend\n");
  EXPECT_TRUE(has(log, "set xrange [1:400]\n"));
  EXPECT_TRUE(has(log_of(Plot::oneshot, {450}), "set xrange [1:500]\n"));
}

TEST(Log, AllNegative) {
  EXPECT_EQ(data_of(log_of(Plot::communication, {-1})),
            "000000 \t000000\n# negative Values following\n#-000001 \t000001\n\nend\n");
}

TEST(Log, SecondsTakeFewLines) {
  const std::string log = log_of(Plot::oneshot, {5, 3000000, -2200000});
  EXPECT_EQ(data_of(log),
            "000000 \t000000\n000004 \t000000\n000005 \t000001\n"
            "000006 \t000000\n2999999 \t000000\n3000000 \t000001\n"
            "# negative Values following\n#-2200000 \t000001\n#-2199999 \t000000\n#-000001 \t000000\n\nend\n");
}

TEST(Log, NothingMeasured) {
  const std::string log = log_of(Plot::oneshot, {});
  EXPECT_TRUE(has(log, "Latency in micro seconds - no samples\"\n"));
  EXPECT_EQ(data_of(log), "000000 \t000000\n\nend\n");
}

TEST(Log, NamesCannotBreakOutOfTheirQuotes) {
  Series series("x");
  series.add(1000, 0);
  const std::string log = gnuplot_log(Plot::oneshot, "a\"b", "c\\\"\nd", series, {});
  EXPECT_TRUE(has(log, "set title \"a\\\"b\"\n"));
  EXPECT_TRUE(has(log, "set output \"c\\\\\\\" d.jpg\"\n"));
}
