#include <gtest/gtest.h>

#include <csignal>
#include <cstddef>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "dfr/dds/channel.h"
#include "tests/dds/domain.h"
#include "tests/dds/peer_process.h"
#include "tests/support/eventually.h"

namespace dfr::test {
namespace {

// Returns the files below /dev/shm that the process has mapped.
std::vector<std::string> SharedMemory(const PeerProcess& process) {
  std::ifstream maps("/proc/" + std::to_string(process.pid()) + "/maps");
  std::vector<std::string> files;
  for (std::string line; std::getline(maps, line);) {
    const std::size_t at = line.find("/dev/shm/");
    if (at != std::string::npos && line.find("(deleted)") == std::string::npos) {
      files.push_back(line.substr(at));
    }
  }
  return files;
}

// Processes share ports. A process killed by another test in the same domain leaves its files.
void RemoveOldPorts(int domain) {
  for (int port = 7400 + 250 * domain; port < 7400 + 250 * (domain + 1); ++port) {
    const std::string name = "fastrtps_port" + std::to_string(port);
    for (const std::string& file : {name, name + "_el", "sem." + name + "_mutex"}) {
      std::filesystem::remove("/dev/shm/" + file);
    }
  }
}

TEST(DvrkSimulatorTest, PublishesPicturesAndLeavesNoSharedMemory) {
  RemoveOldPorts(OwnDomain());
  PeerProcess simulator({DFR_SIMULATOR, "--domain", std::to_string(OwnDomain())});
  {
    dds::Participant client({.domain = OwnDomain()});
    dds::Subscriber<dds::Image> images(client, "/ECM/image_raw", dds::Role::kImage);
    dds::Image image;
    Eventually([&] { return images.TakeNewest(image); });
    EXPECT_EQ(image.data.size(), std::size_t{480} * 1920);
  }
  const std::vector<std::string> files = SharedMemory(simulator);
  EXPECT_FALSE(files.empty());
  simulator.Signal(SIGINT);
  EXPECT_EQ(simulator.Await(), 0);
  for (const std::string& file : files) EXPECT_FALSE(std::filesystem::exists(file)) << file;
}

TEST(DvrkSimulatorTest, WrongOptionsAreRefused) {
  EXPECT_GT(PeerProcess({DFR_SIMULATOR, "--domain", "400"}).Await(), 0);
  EXPECT_EQ(PeerProcess({DFR_SIMULATOR, "--drop", "2"}).Await(), 2);
  EXPECT_EQ(PeerProcess({DFR_SIMULATOR, "--arm-error", "-1"}).Await(), 2);
  EXPECT_GT(PeerProcess({DFR_SIMULATOR, "--wave", "tsunami"}).Await(), 0);
  EXPECT_EQ(PeerProcess({DFR_SIMULATOR, "--help"}).Await(), 0);
}

}  // namespace
}  // namespace dfr::test
