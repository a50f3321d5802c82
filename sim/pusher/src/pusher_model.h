#pragma once

#include <string_view>

namespace dfr::sim::internal {

/// The text of models/pusher.xml, so that a binary needs no file beside it.
extern const std::string_view kPusherXml;

}  // namespace dfr::sim::internal
