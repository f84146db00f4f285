#include <dirent.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <cstdlib>
#include <fstream>
#include <iterator>

#include "rt_tests_support/errors.h"
#include "rt_tests_support/files.h"
#include "rt_tests_support/json.h"
#include "rt_tests_support/process.h"

using namespace rt_tests;

namespace {

struct Folder {
  std::string path;
  Folder() {
    char name[] = "/tmp/rt_tests_XXXXXX";
    path = mkdtemp(name);
  }
  ~Folder() { [[maybe_unused]] const int done = std::system(("rm -r " + path).c_str()); }
  int files() const {
    int count = 0;
    DIR* handle = opendir(path.c_str());
    while (const dirent* item = readdir(handle)) count += std::string(item->d_name).find_first_not_of('.') != std::string::npos;
    closedir(handle);
    return count;
  }
};

std::string content(const std::string& path) {
  std::ifstream stream(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

}  // namespace

TEST(Json, IsEscaped) {
  EXPECT_EQ(json_string("a\"b\\c\n\x01"), "\"a\\\"b\\\\c\\u000a\\u0001\"");
  EXPECT_EQ(json_string("\xc3\xa4\xf0\x9f\x99\x82"), "\"\xc3\xa4\xf0\x9f\x99\x82\"");
  EXPECT_EQ(json_string("\xff" "a\xc3"), "\"\\ufffda\\ufffd\"");
  EXPECT_EQ(json_string("\xed\xa0\x80\xc0\x80"), "\"\\ufffd\\ufffd\\ufffd\\ufffd\\ufffd\"");
}

TEST(Json, Nests) {
  Json json;
  json.open('{').field("a", 1).key("b").null().field("c", std::vector<int64_t>{1, -2}).key("d").open('{').close();
  json.key("e").open('[').open('{').field("f", true).close().open('{').close().close().close();
  std::string text = json.text();
  text.erase(std::remove_if(text.begin(), text.end(), [](char c) { return c == ' ' || c == '\n'; }), text.end());
  EXPECT_EQ(text, "{\"a\":1,\"b\":null,\"c\":[1,-2],\"d\":{},\"e\":[{\"f\":true},{}]}");
}

TEST(Npy, Header) {
  Folder folder;
  const int64_t data[] = {1, 2, 3, 4, 5, 6};
  write_npy(folder.path + "/a.npy", data, 3, 2);
  const std::string bytes = content(folder.path + "/a.npy");
  EXPECT_EQ(bytes.substr(0, 8), std::string("\x93NUMPY\x01\x00", 8));
  EXPECT_EQ((bytes.size() - sizeof data) % 64, 0u);
  EXPECT_NE(bytes.find("'fortran_order': False, 'shape': (3, 2)"), std::string::npos);
  EXPECT_EQ(bytes.substr(bytes.size() - sizeof data), std::string(reinterpret_cast<const char*>(data), sizeof data));
}

TEST(Files, AreWholeOrNotThere) {
  Folder folder;
  write_file(folder.path + "/a", {{"12", 2}, {"3", 1}});
  EXPECT_EQ(content(folder.path + "/a"), "123");
  EXPECT_EQ(folder.files(), 1);
  EXPECT_THROW(write_file(folder.path + "/no/a", {{"1", 1}}), Failure);
  mkdir((folder.path + "/taken").c_str(), 0755);
  EXPECT_THROW(write_file(folder.path + "/taken", {{"1", 1}}), Failure);  // renaming onto a folder fails
  EXPECT_EQ(folder.files(), 2);
}

TEST(Files, FullDiskLeavesNothing) {
  Folder folder;
  // The limit on a file's size fails like a full disk does: in the middle.
  const pid_t child = fork();
  if (child == 0) {
    signal(SIGXFSZ, SIG_IGN);
    const rlimit limit{4096, 4096};
    setrlimit(RLIMIT_FSIZE, &limit);
    const std::string data(10000, 'x');
    try {
      write_file(folder.path + "/a", {{data.data(), data.size()}});
    } catch (const Failure& failure) {
      _exit(std::string(failure.what()).find("File too large") != std::string::npos ? 7 : 8);
    }
    _exit(9);
  }
  int status = 0;
  waitpid(child, &status, 0);
  EXPECT_EQ(WEXITSTATUS(status), 7);
  EXPECT_EQ(folder.files(), 0);
}

TEST(Files, FolderIsLookedAtBefore) {
  EXPECT_NO_THROW(require_writable_folder(folder_of("name")));
  EXPECT_THROW(require_writable_folder(folder_of("/no/such/name")), UsageError);
  EXPECT_THROW(require_writable_folder(folder_of("/etc/passwd/name")), UsageError);
}

TEST(Process, ThreadsAreReadBackFromTheKernel) {
  const auto threads = read_threads();
  ASSERT_EQ(threads.size(), 1u);
  EXPECT_EQ(threads[0].tid, getpid());
  EXPECT_EQ(threads[0].policy, "OTHER");
  EXPECT_EQ(threads[0].priority, 0);
  EXPECT_FALSE(threads[0].cpus.empty());
  EXPECT_FALSE(threads[0].name.empty());
}
