#include "robot/terminal.h"

#include <gtest/gtest.h>

#include <csignal>
#include <cstdlib>

namespace dfr::apps::line_tracking {
namespace {

// Otherwise a closed terminal or a lost connection would end the program before it holds the robot.
TEST(TerminalTest, AClosedTerminalInterruptsAndAClosedPipeDoesNotEndTheProgram) {
  EXPECT_EXIT(
      {
        Terminal terminal;
        std::raise(SIGPIPE);
        if (Terminal::interrupted()) std::exit(2);
        std::raise(SIGHUP);
        std::exit(Terminal::interrupted() ? EXIT_SUCCESS : EXIT_FAILURE);
      },
      testing::ExitedWithCode(EXIT_SUCCESS), "");
}

}  // namespace
}  // namespace dfr::apps::line_tracking
