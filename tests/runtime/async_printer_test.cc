// Output for the operator of a run, printed by a separate thread.
#include "dfr/runtime/async_printer.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <string>

#include "tests/runtime/pipe.h"
#include "tests/support/eventually.h"

namespace dfr::runtime {
namespace {

using test::Pipe;

TEST(AsyncPrinterTest, PrintsAllInOrder) {
  const Pipe shown;
  {
    AsyncPrinter printer(shown.out());
    for (int i = 0; i < 3; ++i) printer.Say("line %d of %s\n", i, "three");
  }
  EXPECT_EQ(shown.Text(), "line 0 of three\nline 1 of three\nline 2 of three\n");
}

TEST(AsyncPrinterTest, WordsOfADeviceDoNotControlTheTerminal) {
  const Pipe shown;
  AsyncPrinter(shown.out()).Say("console: %s\n", "fault \x1b[2J\xc2\x9b");
  EXPECT_EQ(shown.Text(), "console: fault ?[2J?\?\n");
}

// After Ctrl-S a terminal accepts no output. Neither the loop nor the end of the program waits
// indefinitely for the terminal.
TEST(AsyncPrinterTest, DoesNotWaitForAStoppedTerminal) {
  const Pipe shown;
  ::fcntl(shown.out(), F_SETFL, O_NONBLOCK);
  const std::string much(4096, 'x');
  while (::write(shown.out(), much.data(), much.size()) > 0) {
  }
  ::fcntl(shown.out(), F_SETFL, 0);
  AsyncPrinter printer(shown.out(), 10);
  for (int i = 0; i < 1000; ++i) printer.Say("line %d\n", i);
}

TEST(AsyncPrinterTest, ReportsLostLines) {
  const Pipe shown;
  std::string text;
  {
    AsyncPrinter printer(shown.out());
    // More lines than the pipe and the queue hold.
    for (int i = 0; i < 20'000; ++i) printer.Say("line %d\n", i);
    test::Eventually([&] {
      text += shown.Text();
      return text.find("lines were not shown") != std::string::npos;
    });
  }
  EXPECT_EQ(text.find("line 0\n"), 0U);
}

}  // namespace
}  // namespace dfr::runtime
