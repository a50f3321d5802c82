#pragma once

#include "check/check.h"
#include "dfr/dds/participant.h"

namespace dfr::apps::hardware_app {

/// Reports why no console of options.arm was found: security refuses it, or the console is in
/// another domain, uses another kind of discovery, or has another arm.
void ExplainMissing(const CheckOptions& options, const dds::Participant& participant,
                    DeviceReport& report);

}  // namespace dfr::apps::hardware_app
