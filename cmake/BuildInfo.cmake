# Run at every build: writes OUTPUT with the commit of SOURCE, and leaves the file alone when nothing
# has changed, so that nothing is rebuilt.
set(commit unknown)
execute_process(COMMAND git -C ${SOURCE} rev-parse --short=12 HEAD
  OUTPUT_VARIABLE head OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET RESULT_VARIABLE failed)
if(NOT failed)
  set(commit ${head})
  execute_process(COMMAND git -C ${SOURCE} status --porcelain --untracked-files=no
    OUTPUT_VARIABLE changes ERROR_QUIET)
  if(changes)
    string(APPEND commit "+changes")
  endif()
endif()
file(CONFIGURE OUTPUT ${OUTPUT} CONTENT [[
#include "dfr/core/build_info.h"

namespace dfr::core {

const char* BuildVersion() noexcept { return "@VERSION@"; }
const char* BuildCommit() noexcept { return "@commit@"; }

}  // namespace dfr::core
]] @ONLY)
