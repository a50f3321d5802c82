# Runs at every build. Writes the commit of SOURCE to OUTPUT if the commit has changed. Otherwise OUTPUT stays
# unchanged and nothing is rebuilt. In an unpacked archive, commit.txt contains the commit.
set(commit unknown)
file(STRINGS ${SOURCE}/cmake/commit.txt archived LIMIT_COUNT 1)
execute_process(COMMAND git -C ${SOURCE} rev-parse --short=12 HEAD
  OUTPUT_VARIABLE head OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET RESULT_VARIABLE failed)
if(archived MATCHES "^[0-9a-f]+$")
  string(SUBSTRING ${archived} 0 12 commit)
elseif(NOT failed)
  set(commit ${head})
  execute_process(COMMAND git -C ${SOURCE} status --porcelain --untracked-files=no
    OUTPUT_VARIABLE changes ERROR_QUIET)
  if(changes)
    # Different edits need different names, because a run resumes only a ledger of the same commit name. The
    # build uses an untracked file only if a tracked file names it.
    execute_process(COMMAND git -C ${SOURCE} diff HEAD --binary --no-ext-diff --no-textconv --no-color
      OUTPUT_VARIABLE diff ERROR_QUIET)
    execute_process(COMMAND git -C ${SOURCE} ls-files --others --exclude-standard -- *.h *.cc *.css *.cmake
      COMMAND git -C ${SOURCE} hash-object --stdin-paths
      OUTPUT_VARIABLE untracked ERROR_QUIET)
    string(SHA1 hash "${diff}${untracked}")
    string(SUBSTRING ${hash} 0 8 hash)
    string(APPEND commit "+changes.${hash}")
  endif()
endif()
file(CONFIGURE OUTPUT ${OUTPUT} CONTENT [[
#include "dfr/core/build_info.h"

namespace dfr::core {

const char* BuildVersion() noexcept { return "@VERSION@"; }
const char* BuildCommit() noexcept { return "@commit@"; }

}  // namespace dfr::core
]] @ONLY)
